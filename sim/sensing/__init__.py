"""What a controller gets to know: sensors with errors, touch, and the estimated object pose."""
