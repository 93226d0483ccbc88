"""How much fdd reads: every limit on files, texts and streams, with its reason; docs/bounds.md is made of it.

What an actuator can physically have (a stroke, a pressure) is no matter of these: units and sections know.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from fdd import markdown
from fdd.errors import InputError


@dataclass(frozen=True)
class Bound:
    """One limit.

    Attributes
    ----------
    value : largest that is read. what : is counted. reason : why this much.
    variable : of the environment, that sets another value; None where there is none.
    """

    value: int
    what: str
    reason: str
    variable: str | None = None


BOUNDS: dict[str, Bound] = {}


def _bound(name: str, value: int, what: str, reason: str, variable: str | None = None) -> int:
    BOUNDS[name] = Bound(value, what, reason, variable)
    return value


def limit(name: str) -> int:
    """A bound that the user may set by an environment variable, as it is now.

    Raises
    ------
    InputError : the variable is no whole number above 0.

    Examples
    --------
    >>> limit("MAX_VALUES") > 0
    True
    """
    bound = BOUNDS[name]
    text = os.environ.get(bound.variable or "", "").strip()
    if not text:
        return bound.value
    if not text.isascii() or not text.isdigit() or len(text) > 18 or int(text) == 0:
        raise InputError(
            f"{text[:40]!r} is no whole number above 0", where=bound.variable, mend=f"e.g. {bound.value}"
        )
    return int(text)


def raised(name: str, needed: int) -> str:
    """How an error line tells that a bound can be raised.

    Examples
    --------
    >>> raised("MAX_VALUES", 2_000_000_000)
    'or, where memory allows, set FDD_MAX_VALUES=2000000000'
    """
    return f"or, where memory allows, set {BOUNDS[name].variable}={needed}"


def table() -> str:
    """All bounds as a Markdown table.

    Examples
    --------
    >>> print(table().splitlines()[0])
    | bound | value | of | why | set by |
    """
    rows = [
        [f"`{name}`", f"{b.value:,}", b.what, b.reason, f"`{b.variable}`" if b.variable else ""]
        for name, b in BOUNDS.items()
    ]
    return "\n".join(markdown.table(["bound", "value", "of", "why", "set by"], rows, "lrl"))


# Logs as a whole
_bound(
    "MAX_LOG_BYTES", 8 << 30, "bytes of a log, packed or (gzip) unpacked",
    "a day of ten channels at 1 kHz; a larger file is a disk image or never ends", "FDD_MAX_LOG_BYTES",
)  # fmt: skip
_bound(
    "MAX_VALUES", 1 << 30, "numbers (rows times columns) held at once",
    "8 GiB of memory", "FDD_MAX_VALUES",
)  # fmt: skip
MAX_SIGNALS = _bound("MAX_SIGNALS", 4096, "columns or fields of a log", "a large rig records some hundred")
MOST_PACKING = _bound(
    "MOST_PACKING", 2000, "declared bytes for each byte that is stored",
    "deflate packs 1032 to 1; a damaged shape would ask for memory that no data fill",
)  # fmt: skip
FREELY_DECLARED_BYTES = _bound(
    "FREELY_DECLARED_BYTES", 16 << 20, "declared bytes that are not compared with what is stored",
    "cheap enough, and constant columns pack well",
)  # fmt: skip
MOST_MATRIX_COLUMNS = _bound(
    "MOST_MATRIX_COLUMNS", 64, "columns of a matrix in HDF5 or MATLAB files",
    "a wider one is a picture or a map, no table of signals",
)  # fmt: skip
DEEPEST_STRUCT = _bound("DEEPEST_STRUCT", 12, "levels of structs in a MATLAB file", "rigs use three")
MOST_MATRIX_DEPTH = _bound(
    "MOST_MATRIX_DEPTH",
    100,
    "levels of cells and structs in a MATLAB file",
    "the reader calls itself for each",
)
LONGEST_NAME = _bound(
    "LONGEST_NAME",
    200,
    "characters of a signal's name, or of an answer, that are looked at",
    "patterns take time squared",
)
MAX_WORKBOOK_BYTES = _bound(
    "MAX_WORKBOOK_BYTES",
    256 << 20,
    "bytes of a workbook",
    "it is held in memory as a whole, some ten times as large",
)
MAX_WORKBOOK_UNPACKED = _bound(
    "MAX_WORKBOOK_UNPACKED",
    2 << 30,
    "bytes of a workbook's parts, unpacked",
    "a full sheet has less than 1 GiB",
)
MAX_CELLS = _bound(
    "MAX_CELLS", 20_000_000, "cells between A1 and the last one of a sheet",
    "a cell takes some 100 bytes; a stray one in the last corner would take terabytes",
)  # fmt: skip
SNIFFED_BYTES = _bound(
    "SNIFFED_BYTES", 262_144, "bytes of a text in which its header is looked for", "titles are a page at most"
)
HEAD_ROWS = _bound("HEAD_ROWS", 200, "rows of a sheet in which its header is looked for", "as above")
MOST_ROWS_LOOKED_AT = _bound(
    "MOST_ROWS_LOOKED_AT", 300_000, "rows by which a channel map is proposed", "five minutes at 1 kHz tell"
)

# Messages
MAX_RECORD_BYTES = _bound(
    "MAX_RECORD_BYTES", 1 << 30, "bytes of an MCAP record", "writers' chunks have some MiB"
)
MAX_CHUNK_BYTES = _bound("MAX_CHUNK_BYTES", 1 << 30, "bytes of an MCAP chunk, unpacked", "as above")
MOST_FIELDS = _bound("MOST_FIELDS", 4096, "numbers of a message that are offered", "as columns")
MOST_ELEMENTS = _bound("MOST_ELEMENTS", 64, "elements of an array that are offered", "as a matrix's columns")
DEEPEST_MESSAGE = _bound(
    "DEEPEST_MESSAGE", 16, "levels of messages or JSON objects", "ROS types have some six"
)
MOST_OPERATIONS = _bound(
    "MOST_OPERATIONS", 20_000, "steps that read a ROS message",
    "a fixed array has one for each element; definitions can multiply without end",
)  # fmt: skip
MOST_VISITED = _bound(
    "MOST_VISITED", 65_536, "numbers and messages looked at in a Protobuf type", "types may hold themselves"
)
MOST_SCHEMA_FILES = _bound("MOST_SCHEMA_FILES", 1000, "files of a Protobuf schema", "their order is sought")

# Texts
MAX_MAP_BYTES = _bound("MAX_MAP_BYTES", 1_000_000, "bytes of a channel map", "one has some hundred lines")
MAX_WORDS_BYTES = _bound("MAX_WORDS_BYTES", 200_000, "bytes of a file of words", "the shipped one has 6000")
MAX_UNIT_BYTES = _bound(
    "MAX_UNIT_BYTES", 2_000_000, "bytes of a unit profile", "one with a baseline has some 50,000"
)
MAX_RECIPE_BYTES = _bound("MAX_RECIPE_BYTES", 1_000_000, "bytes of a recipe", "one has a page")
MAX_ANSWER_BYTES = _bound(
    "MAX_ANSWER_BYTES", 100_000, "bytes of a data sheet's answers", "one line a question"
)
MAX_SCENARIO_BYTES = _bound(
    "MAX_SCENARIO_BYTES", 5_000_000, "bytes of a scenario", "programmes of many points"
)
MAX_MODEL_BYTES = _bound("MAX_MODEL_BYTES", 1_000_000, "bytes of a model", "two curves")
MAX_CLASSIFIER_BYTES = _bound(
    "MAX_CLASSIFIER_BYTES",
    1 << 30,
    "bytes of a classifier, unpacked",
    "a forest of 1000 trees has some 100 MB",
)
MAX_JSON_BYTES = _bound("MAX_JSON_BYTES", 200_000_000, "bytes of a data set's JSON", "labels of 100,000 logs")
MAX_ANSWERS_BYTES = _bound(
    "MAX_ANSWERS_BYTES", 1 << 30, "bytes of an earlier `answers.jsonl`", "some 100,000 answers"
)
MOST_DEPTH = _bound("MOST_DEPTH", 30, "levels of YAML", "a profile has seven")
MOST_NODES = _bound(
    "MOST_NODES", 200_000, "keys, values and items of YAML", "a profile with its baseline has some 2000"
)
LONGEST_NUMBER = _bound("LONGEST_NUMBER", 1000, "characters of a YAML number", "long ones take time squared")
LONGEST_BASE_60 = _bound(
    "LONGEST_BASE_60", 40, "characters of a YAML number such as 1:20:30", "a million places would take hours"
)

# The monitor
MAX_LINE_BYTES = _bound("MAX_LINE_BYTES", 16 << 20, "bytes of a JSON line", "that of a block of the service")
MOST_PENDING = _bound("MOST_PENDING", 4096, "lines that wait for the pipeline", "four seconds at 1 kHz")
MAX_STATE_BYTES = _bound(
    "MAX_STATE_BYTES", 256 << 20, "bytes of a monitor's state, unpacked", "one has some MiB"
)

# The service
MAX_BLOCK_BYTES = _bound(
    "MAX_BLOCK_BYTES", 16 << 20, "bytes of a block message", "100 rows of all channels have some 20,000"
)
MOST_BLOCK_ROWS = _bound("MOST_BLOCK_ROWS", 100_000, "rows of a block", "100 s at 1 kHz")
MOST_BLOCK_COLUMNS = _bound("MOST_BLOCK_COLUMNS", 256, "columns of a block", "a map picks the channels")
MOST_SEQUENCE = _bound("MOST_SEQUENCE", (1 << 53) - 1, "sequence number of a block", "exact in JSON")
MOST_AXES = _bound("MOST_AXES", 1000, "axes of a service", "each holds a pipeline of some MiB")
MOST_HELD_BLOCKS = _bound(
    "MOST_HELD_BLOCKS", 1000, "blocks of an axis that wait for one before them", "half a second has some 5"
)
MOST_CONNECTIONS = _bound("MOST_CONNECTIONS", 256, "TCP connections of a source", "a thread each")
MAX_SERVE_BYTES = _bound("MAX_SERVE_BYTES", 1_000_000, "bytes of `serve.yaml`", "one has a page")
MAX_DONE_BYTES = _bound(
    "MAX_DONE_BYTES", 64 << 20, "bytes of a folder's note of what is done", "some 200 a log"
)
MAX_TOKENS_BYTES = _bound("MAX_TOKENS_BYTES", 1_000_000, "bytes of a file of tokens", "one line a token")
MAX_REQUEST_BYTES = _bound(
    "MAX_REQUEST_BYTES", 1 << 14, "bytes of a request's body", "a note has 1000 characters"
)
MAX_HEAD_BYTES = _bound(
    "MAX_HEAD_BYTES", 1 << 14, "bytes of a request's line and headers", "browsers send some 1000"
)
MOST_HTTP_CONNECTIONS = _bound(
    "MOST_HTTP_CONNECTIONS", 512, "HTTP connections", "open files are bounded by the system"
)
MOST_LISTENERS = _bound("MOST_LISTENERS", 64, "pages and programs that hear events at once", "control rooms")
