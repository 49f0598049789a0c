"""Which parts go into which box: the task, and the search that fills one box after another."""
