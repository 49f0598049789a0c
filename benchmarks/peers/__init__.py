"""Other ways of packing, on the tasks that PackIt-Sim's agents play; see `__main__`."""
