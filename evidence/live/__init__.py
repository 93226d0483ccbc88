"""How many axes one core watches in real time, what that costs, and where the time goes."""
