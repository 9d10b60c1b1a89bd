"""What the operators look like in Blender: panels, preferences, scene settings."""
