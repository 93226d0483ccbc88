"""A log that is sent: diagnosed by ``fdd diagnose`` in a process of its own, with bounds on everything."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
from starlette.exceptions import HTTPException

from fdd.logs.formats.registry import suffixes

PROGRAM = "import os; os.nice(10); from fdd.cli import main; main()"
MOST_AT_ONCE, MOST_WAITING = 1, 2
LONGEST_S = 300.0
MOST_VALUES = 100_000_000
"""Numbers of one log held at once: 0.8 GB."""


@dataclass(frozen=True)
class Folders:
    """Where profiles and channel maps lie that a request may name; None where it may name none."""

    units: Path | None = None
    maps: Path | None = None


class Uploads:
    """Diagnoses of logs that are sent, one at a time.

    A process can be ended when its time is up, and takes nothing with it when its memory is.

    Examples
    --------
    >>> answer = await Uploads(Folders()).diagnose(chunks, "run.csv", None, None)  # doctest: +SKIP
    """

    def __init__(self, folders: Folders, longest: float = LONGEST_S) -> None:
        self._folders, self._longest = folders, longest
        self._turn = asyncio.Semaphore(MOST_AT_ONCE)
        self._here = 0

    async def diagnose(
        self, body: AsyncIterator[bytes], name: str, unit: str | None, map_: str | None
    ) -> dict[str, Any]:
        """The answer (``fdd.diagnosis/1``) for a log.

        Parameters
        ----------
        body : the log. name : what it is called, of which only a known ending is used.
        unit : a shipped profile or a file's stem in the folder. map_ : likewise.

        Raises
        ------
        HTTPException : 400 for a log that cannot be used, 503 when too many wait, 504 when it takes too long.
        """
        suffix = next((s for s in sorted(suffixes(), key=len, reverse=True) if name.lower().endswith(s)), "")
        if not suffix:
            raise HTTPException(400, f"the name ends in none of {', '.join(suffixes())}")
        options = [*_named("--unit", unit, self._folders.units), *_named("--map", map_, self._folders.maps)]
        if self._here >= MOST_AT_ONCE + MOST_WAITING:
            raise HTTPException(503, "too many logs wait for a diagnosis", {"retry-after": "60"})
        self._here += 1
        try:
            with tempfile.TemporaryDirectory(prefix="fdd-") as folder:
                log = Path(folder) / f"log{suffix}"
                with log.open("wb") as target:
                    async for chunk in body:
                        target.write(chunk)
                async with self._turn:
                    return await self._run(log, options, name)
        finally:
            self._here -= 1

    async def _run(self, log: Path, options: list[str], name: str) -> dict[str, Any]:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-c", PROGRAM, "diagnose", log.name, *options, "--json", "-",
            cwd=log.parent, stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            env={"FDD_MAX_VALUES": str(MOST_VALUES), "FDD_MAX_LOG_BYTES": str(1 << 30)} | os.environ,
        )  # fmt: skip
        try:
            out, told = await asyncio.wait_for(process.communicate(), self._longest)
        except TimeoutError:
            raise HTTPException(
                504, f"not diagnosed within {self._longest:.0f} s; use fdd diagnose"
            ) from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        shown = "".join(c for c in name if c.isprintable())[:200]
        if process.returncode != 0:
            lines = told.decode("utf-8", "replace").strip().splitlines() or ["internal error"]
            text = (
                lines[-1].removeprefix("fdd: error: ").replace(str(log.parent), "").replace(log.name, shown)
            )
            raise HTTPException(400 if process.returncode == 2 else 500, text)
        return orjson.loads(out) | {"log": shown}


def _named(option: str, name: str | None, folder: Path | None) -> list[str]:
    """A file that is found by its name in a listing: no path is ever made of what a client says."""
    if name is None:
        return []
    files = {} if folder is None else {p.stem: p for p in sorted(folder.glob("*.yaml"))}
    if option == "--unit":
        from fdd.unit import shipped_units

        known = {u: u for u in shipped_units()} | {stem: str(p.resolve()) for stem, p in files.items()}
    else:
        known = {stem: str(p.resolve()) for stem, p in files.items()}
    if name not in known:
        kind = option.lstrip("-")
        raise HTTPException(400, f"no {kind} of that name; there are: {', '.join(sorted(known)) or 'none'}")
    return [option, known[name]]
