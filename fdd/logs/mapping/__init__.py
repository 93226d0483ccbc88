"""Channel maps that write themselves: from names, units, and what the signals do."""

from fdd.logs.mapping.concepts import Words
from fdd.logs.mapping.proposal import Given, Proposal, Question, given_of, propose

__all__ = ["Given", "Proposal", "Question", "Words", "given_of", "propose"]
