"""The extension in real Blenders with a window, driven by mouse: ``python -m tests.real_blender``."""
