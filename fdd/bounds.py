"""How much fdd reads: every limit on files, texts and streams. docs/bounds.md has the reason for each.

What an actuator can physically have (a stroke, a pressure) is no matter of these: units and sections know.
"""

from __future__ import annotations

import os

from fdd.errors import InputError

RAISABLE = {"MAX_LOG_BYTES": 8 << 30, "MAX_VALUES": 1 << 30}
"""Bytes of a log, packed or (gzip) unpacked, and numbers (rows times columns) held at once: the user may set
them by an environment variable of that name after ``FDD_``."""


def limit(name: str) -> int:
    """A bound of `RAISABLE`, as it is now; an InputError where the variable is no whole number above 0."""
    text = os.environ.get(f"FDD_{name}", "").strip() or str(RAISABLE[name])
    if not text.isascii() or not text.isdigit() or len(text) > 18 or int(text) == 0:
        problem = f"{text[:40]!r} is no whole number above 0"
        raise InputError(problem, where=f"FDD_{name}", mend=f"e.g. {RAISABLE[name]}")
    return int(text)


def raised(name: str, needed: int) -> str:
    """How an error line tells that a bound can be raised."""
    return f"or, where memory allows, set FDD_{name}={needed}"


# Logs as a whole
MAX_SIGNALS = 4096  # columns or fields of a log
MOST_PACKING = 2000  # declared bytes for each byte that is stored
FREELY_DECLARED_BYTES = 16 << 20  # declared bytes that are not compared with what is stored
MOST_MATRIX_COLUMNS = 64  # columns of a matrix in HDF5 or MATLAB files
DEEPEST_STRUCT = 12  # levels of structs in a MATLAB file
MOST_MATRIX_DEPTH = 100  # levels of cells and structs in a MATLAB file
LONGEST_NAME = 200  # characters of a signal's name, or of an answer, that are looked at
MAX_WORKBOOK_BYTES = 256 << 20  # bytes of a workbook
MAX_WORKBOOK_UNPACKED = 2 << 30  # bytes of a workbook's parts, unpacked
MAX_CELLS = 20_000_000  # cells between A1 and the last one of a sheet
SNIFFED_BYTES = 262_144  # bytes of a text in which its header is looked for
HEAD_ROWS = 200  # rows of a sheet in which its header is looked for
MOST_ROWS_LOOKED_AT = 300_000  # rows by which a channel map is proposed

# Messages
MAX_RECORD_BYTES = 1 << 30  # bytes of an MCAP record
MAX_CHUNK_BYTES = 1 << 30  # bytes of an MCAP chunk, unpacked
MOST_FIELDS = 4096  # numbers of a message that are offered
MOST_ELEMENTS = 64  # elements of an array that are offered
DEEPEST_MESSAGE = 16  # levels of messages or JSON objects
MOST_OPERATIONS = 20_000  # messages inside a ROS message
MOST_SCHEMA_FILES = 1000  # files of a Protobuf schema

# Texts
MAX_MAP_BYTES = 1_000_000  # bytes of a channel map
MAX_UNIT_BYTES = 2_000_000  # bytes of a unit profile
MAX_RECIPE_BYTES = 1_000_000  # bytes of a recipe
MAX_ANSWER_BYTES = 100_000  # bytes of a data sheet's answers
MAX_SCENARIO_BYTES = 5_000_000  # bytes of a scenario
MAX_MODEL_BYTES = 1_000_000  # bytes of a model
MAX_CLASSIFIER_BYTES = 1 << 30  # bytes of a classifier, unpacked
MAX_JSON_BYTES = 200_000_000  # bytes of a data set's JSON
MAX_ANSWERS_BYTES = 1 << 30  # bytes of an earlier `answers.jsonl`
MOST_DEPTH = 30  # levels of YAML
MOST_NODES = 200_000  # keys, values and items of YAML
LONGEST_NUMBER = 1000  # characters of a YAML number
LONGEST_BASE_60 = 40  # characters of a YAML number such as 1:20:30

# The monitor
MAX_LINE_BYTES = 16 << 20  # bytes of a JSON line
MOST_PENDING = 4096  # lines that wait for the pipeline

# The service
MAX_BLOCK_BYTES = 16 << 20  # bytes of a block message
MOST_BLOCK_ROWS = 100_000  # rows of a block
MOST_BLOCK_COLUMNS = 256  # columns of a block
MOST_SEQUENCE = (1 << 53) - 1  # sequence number of a block
MOST_AXES = 1000  # axes of a service
MOST_HELD_BLOCKS = 1000  # blocks of an axis that wait for one before them
MOST_CONNECTIONS = 256  # TCP connections of a source
MAX_SERVE_BYTES = 1_000_000  # bytes of `serve.yaml`
MAX_DONE_BYTES = 64 << 20  # bytes of a folder's note of what is done
MAX_TOKENS_BYTES = 1_000_000  # bytes of a file of tokens
MAX_REQUEST_BYTES = 1 << 14  # bytes of a request's body
MAX_HEAD_BYTES = 1 << 14  # bytes of a request's line and headers
MOST_HTTP_CONNECTIONS = 512  # HTTP connections
MOST_LISTENERS = 64  # pages and programs that hear events at once
