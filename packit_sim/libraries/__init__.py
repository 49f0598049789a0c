"""Libraries of shapes: mesh files, folders, ShapeNet, and libraries that the importer stores."""
