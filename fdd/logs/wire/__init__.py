"""Messages as bytes to columns of numbers: MCAP's chunks, Protobuf, ROS's CDR, JSON."""
