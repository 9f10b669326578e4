"""What ties and drives a hand's joints, and what a description says of them: plain data."""
