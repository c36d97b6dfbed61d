"""``blender://SCENE.blend``: captures that Blender renders, in a process of its own."""
