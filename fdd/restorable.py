"""State of the live pipeline: saved and restored by one description, the attributes that a class names."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fdd.samples import Samples

Array = NDArray[Any]
_PLAIN = (type(None), bool, int, float, str)


class Restorable:
    """Saves and restores, in this order, the attributes (or properties with a setter) that `STATE` names.

    They hold None, numbers, strings, arrays, `Samples`, the dataclasses, named tuples and Pydantic models of
    `STATE_CLASSES`, and lists, tuples, sets and dicts of these. What has its own `state` and `restore`, and a
    dict of nothing else, is restored in place. Each such object has two arrays of bytes: its values as JSON,
    and one after the other what their arrays hold.
    """

    STATE: ClassVar[tuple[str, ...]] = ()
    STATE_CLASSES: ClassVar[tuple[type[Any], ...]] = ()

    def state(self) -> dict[str, Array]:
        """A copy of it as named arrays. Raises TypeError: a value of a class that is not declared."""
        out, tree, data = dict[str, Array](), {}, [np.empty(0, np.uint8)]
        for name in self.STATE:
            parts = _parts(name, getattr(self, name))
            tree[name] = None if parts else self._written(getattr(self, name), data)
            out |= {place + k: v for place, part in parts.items() for k, v in part.state().items()}
        return {"values": packed(tree), "arrays": np.concatenate(data), **out}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` gave. Raises KeyError, ValueError, TypeError: it is damaged."""
        try:
            tree, data = unpacked(state["values"]), [state["arrays"].view(np.uint8)]
            for name in self.STATE:
                old = getattr(self, name)
                for place, part in _parts(name, old).items():
                    part.restore({k.removeprefix(place): v for k, v in state.items() if k.startswith(place)})
                if not _parts(name, old):
                    new = self._read(tree[name], data)
                    numbers = isinstance(old, Real) and isinstance(new, Real)
                    if not (numbers or old is None or new is None or type(old) is type(new)):
                        raise TypeError(f"{name} is of another type")
                    setattr(self, name, new)
            if data[0].size:
                raise ValueError("more arrays than values")
        except (AttributeError, IndexError, ArithmeticError, RecursionError, MemoryError) as error:
            raise ValueError(f"damaged state ({type(error).__name__})") from None

    def _written(self, value: Any, data: list[Array]) -> Any:
        """A value for JSON: as it is, or a list of its kind and parts; its arrays go to `data`."""
        cls = type(value)
        if cls in _PLAIN:
            return value
        if isinstance(value, np.ndarray | np.generic):
            data.append(_bytes_of(np.ascontiguousarray(value)))
            dtype = value.dtype.descr if value.dtype.names else value.dtype.str
            return ["array" if cls is np.ndarray else "number", dtype, value.shape]
        if cls is list and len({*map(type, value)}) == 1:  # many alike become few arrays
            of, first = type(value[0]), value[0]
            if of is float:
                return ["floats", self._written(np.array(value), data)]
            if of is np.ndarray and first.ndim and len({(v.dtype, v.shape) for v in value}) == 1:
                return ["rows", self._written(np.stack(value), data)]
            if of in (list, tuple, dict, Samples, *self.STATE_CLASSES):
                unnamed = issubclass(of, list | tuple)
                keys, parts = ([None], value) if unnamed else zip(*map(self._parted, value), strict=True)
                if parts[0] and keys.count(keys[0]) == len(keys) and len({*map(len, parts)}) == 1:
                    columns = (self._written([*column], data) for column in zip(*parts, strict=True))
                    return ["each", of.__name__, self._written(keys[0], data), *columns]
        keys, parts = self._parted(value)
        return [cls.__name__, self._written(keys, data), *(self._written(part, data) for part in parts)]

    def _parted(self, value: Any) -> tuple[Any, Any]:
        """Names of a value's parts, where they have some, and the parts."""
        cls = type(value)
        if cls not in (list, tuple, set, dict, Samples, *self.STATE_CLASSES):
            raise TypeError(f"{type(self).__name__} does not declare {cls.__name__} in its state")
        if isinstance(value, list | tuple | set):
            return None, sorted(value, key=repr) if cls is set else value
        if cls is Samples:
            return ["time", "columns"], [value.time, value.columns]
        named = value if cls is dict else vars(value)
        return [*named], [*named.values()]

    def _read(self, tree: Any, data: list[Array]) -> Any:
        if type(tree) in _PLAIN:
            return tree
        kind, *parts = tree
        if kind in ("array", "number"):
            named, shape = isinstance(parts[0], list), parts[1]
            dtype = np.dtype([(n, of, *map(tuple, size)) for n, of, *size in parts[0]] if named else parts[0])
            found = np.empty(shape, dtype)
            mine, data[0] = np.split(data[0], [found.nbytes])
            if mine.size < found.nbytes:
                raise ValueError("the arrays end early")
            _bytes_of(found)[:] = mine
            return found if kind == "array" else found[()]
        if kind in ("floats", "rows"):
            found = self._read(parts[0], data)
            return found.tolist() if kind == "floats" else [*found]
        of, keys, *parts = [self._read(part, data) for part in (parts if kind == "each" else tree)]
        cls: Any = {c.__name__: c for c in (list, tuple, set, dict, Samples, *self.STATE_CLASSES)}[of]
        rows: Iterable[Any] = zip(*parts, strict=True) if kind == "each" else [parts]
        if keys is None:
            made = [*map(getattr(cls, "_make", cls), rows)]
        else:
            made = [dict(zip(keys, row, strict=True)) for row in rows]
            made = made if cls is dict else [cls(**named) for named in made]
        return made if kind == "each" else made[0]


def _bytes_of(array: Array) -> Array:
    return array.reshape(-1).view(np.uint8)


def _parts(name: str, value: Any) -> dict[str, Any]:
    """What of an attribute has a state of its own, by what the names of its arrays begin with."""
    parts = {f"{name}/{k}/": v for k, v in value.items()} if isinstance(value, dict) else {f"{name}/": value}
    return parts if all(hasattr(v, "restore") for v in parts.values()) else {}


def packed(tree: Any) -> Array:
    """JSON as bytes, to travel among a state's arrays."""
    return np.frombuffer(json.dumps(tree).encode(), np.uint8)


def unpacked(data: Array) -> Any:
    """JSON that a state carries as bytes."""
    return json.loads(bytes(data))
