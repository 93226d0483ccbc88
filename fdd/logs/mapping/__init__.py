"""Channel maps that write themselves: from names, units, and what the signals do."""

from fdd.logs.mapping.concepts import Words
from fdd.logs.mapping.given import Given, given_of
from fdd.logs.mapping.proposal import Proposal, Question, propose

__all__ = ["Given", "Proposal", "Question", "Words", "given_of", "propose"]
