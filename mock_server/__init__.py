"""A UnrealCV server over an analytic scene, for tests, demos and newcomers without Unreal."""
