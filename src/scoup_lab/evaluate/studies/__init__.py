"""Studies of the method on scenes rasterised once."""
