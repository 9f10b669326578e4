"""What our verdict says of grasps that somebody else made."""
