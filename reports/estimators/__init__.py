"""How well the EHA estimators do: against the Cramér-Rao bound."""
