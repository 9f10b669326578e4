"""A mesh as a few convex pieces, for engines that collide convex geometries."""
