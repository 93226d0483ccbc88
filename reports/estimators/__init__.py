"""How well the EHA estimators do: against the Cramér-Rao bound, least squares and filterpy."""
