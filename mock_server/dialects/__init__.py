"""The commands of each dialect."""
