"""What the diagnosis says of logs that were changed, and of faults that no catalogue has."""
