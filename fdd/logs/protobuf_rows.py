"""Protobuf messages of one length, so that a block of them is one NumPy array."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from fdd.errors import InputError


def layout(title: str, fields: Mapping[str, bool]) -> tuple[bytes, bytes, np.dtype[np.void]]:
    """Lay out messages that always hold all their fields.

    Parameters
    ----------
    title : the type's name, ``package.Name``.
    fields : name of each ``optional double`` (False) and ``optional bool`` (True); ``ekf.leakage`` is the
        field leakage of the nested message ekf.

    Returns
    -------
    The schema, a serialised FileDescriptorSet; a message of zeros; where its values stand, by name.

    Raises
    ------
    InputError : a name that Protobuf cannot take.

    Examples
    --------
    >>> _, message, places = layout("fdd.Truth", {"leakage": False, "stuck": True})
    >>> message.hex(), places.fields["stuck"]
    ('0900000000000000001000', (dtype('bool'), 10))
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    package, _, name = title.rpartition(".")
    files = FileDescriptorSet()
    # proto2, whose fields tell whether they are there without the made-up oneofs of proto3.
    file = files.file.add(name=f"{title}.proto", package=package, syntax="proto2")
    message, places = _lay(fields, file.message_type.add(name=name), f".{title}")
    names, formats, offsets = zip(*places, strict=True)
    dtype: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(message)}
    return files.SerializeToString(), message, np.dtype(dtype)


def _lay(fields: Mapping[str, bool], type_: Any, title: str) -> tuple[bytes, list[tuple[str, str, int]]]:
    """Declare the fields; the message of zeros, and name, format and offset of each value."""
    groups: dict[str, dict[str, bool]] = {}
    for path, boolean in fields.items():
        name, _, rest = path.partition(".")
        groups.setdefault(name, {})[rest] = boolean
    message, places = b"", []
    for number, (name, members) in enumerate(groups.items(), start=1):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
            raise InputError(f"{name[:70]!r} cannot name a field", mend="use letters, digits and _")
        field = type_.field.add(name=name, number=number)
        field.label = field.LABEL_OPTIONAL
        if "" in members:
            boolean = members[""]
            field.type = field.TYPE_BOOL if boolean else field.TYPE_DOUBLE
            message += _varint(number << 3 | (not boolean))
            places.append((name, "?" if boolean else "<f8", len(message)))
            message += bytes(1 if boolean else 8)
        else:
            field.type, field.type_name = field.TYPE_MESSAGE, f"{title}.{name}_fields"
            inner, below = _lay(members, type_.nested_type.add(name=f"{name}_fields"), field.type_name)
            message += _varint(number << 3 | 2) + _varint(len(inner))
            places += [(f"{name}.{path}", form, len(message) + at) for path, form, at in below]
            message += inner
    return message, places


def _varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _varint(value >> 7)
