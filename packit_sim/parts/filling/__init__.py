"""Filling of boxes: the task, the search box after box, and the packed parts."""
