"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files."""
