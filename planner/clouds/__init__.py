"""What cameras saw of an object: points with noise, and the surface believed behind them."""
