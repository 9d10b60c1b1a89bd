"""The command line: arguments in, engine and Blender room called, exit code out."""
