"""The command line of the engine, for Python and for Blender in background."""
