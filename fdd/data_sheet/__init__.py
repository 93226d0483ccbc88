"""A base profile typed from a data sheet: the questions, the profile they make, and whether it can be."""

from fdd.data_sheet.answers import QUESTIONS, Answers, Question, parsed, read_answers
from fdd.data_sheet.plausibility import Remark, derived, require_plausible, sheet_remarks, unit_remarks
from fdd.data_sheet.profile import typed_unit

__all__ = [
    "QUESTIONS",
    "Answers",
    "Question",
    "Remark",
    "derived",
    "parsed",
    "read_answers",
    "require_plausible",
    "sheet_remarks",
    "typed_unit",
    "unit_remarks",
]
