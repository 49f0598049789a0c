"""Other packing methods on the tasks that PackIt-Sim's agents play; see `__main__`."""
