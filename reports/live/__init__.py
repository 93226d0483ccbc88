"""``fdd serve`` at work: how many axes one core carries, and weeks of an axis in compressed time."""
