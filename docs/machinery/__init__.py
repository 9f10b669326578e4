"""What Sphinx needs beyond its extensions: pages out of the code, mathematics without a network."""
