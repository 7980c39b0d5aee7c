"""What is measured, by `regrasp bench NAME`."""
