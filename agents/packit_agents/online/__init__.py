"""Online packing of polycubes: values of the heights of columns, learned by playing."""
