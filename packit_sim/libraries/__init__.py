"""Where shapes come from: mesh files, folders, ShapeNet, and libraries stored by the importer."""
