"""What was found once is not found again, and some hundred changed files of each kind find nothing new."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.cases import CORPUS, DATA, KINDS, Task, fuzz, result

EACH = 300


@pytest.mark.parametrize("kind", KINDS)
def test_every_seed_is_read(kind: str, tmp_path: Path) -> None:
    found = {path.name: result(Task(kind, file=path), tmp_path) for path in KINDS[kind].seeds(kind)}
    assert set(found.values()) == {"read"}, found


@pytest.mark.parametrize("kind", DATA)
def test_changed_texts_are_read_or_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    found = [result(Task(kind, seed=7, number=k), tmp_path) for k in range(40)]
    assert set(found) <= {"read", "refused"} and "read" in found, found


@pytest.mark.slow
def test_changed_files_are_read_or_refused_in_one_line() -> None:
    """Corpus: files that once ended the process, hung or raised something else than an `InputError`."""
    corpus = [Task(p.parent.name, file=p) for p in sorted(CORPUS.glob("*/*"))]
    assert len(corpus) >= 15
    out = fuzz([*corpus, *(Task(kind, 1000, k) for kind in KINDS for k in range(EACH))])
    assert not out.finds, "\n".join(f"{task}: {what}" for task, what in out.finds)
    for kind in KINDS:
        both = [out.counts[kind, what] for what in ("read", "refused")]
        assert sum(both) >= EACH and both[0] >= EACH // 100
    assert sum(n for (_, what), n in out.counts.items() if what == "refused") > 4 * EACH
