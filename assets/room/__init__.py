"""The demo room, modelled in Python: shapes, textures, materials, furniture, cameras."""
