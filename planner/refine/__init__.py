"""From a hand pose that somebody else made to the nearest grasp that passes our verdict."""
