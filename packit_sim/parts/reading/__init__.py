"""Parts and boxes as users describe them: mesh files, lists, units, sizes, preparation."""
