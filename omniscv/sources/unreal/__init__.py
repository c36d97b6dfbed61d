"""The live UnrealCV server, over the official client: the only package that knows the wire."""
