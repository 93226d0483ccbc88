"""What was found once is not found again, and a hundred changed files of each kind find nothing new."""

import pytest

from tests.fuzz.targets import CORPUS, KINDS
from tests.fuzz.workers import Task, fuzz, tasks_of

EACH = 100


@pytest.mark.slow
def test_changed_files_are_read_or_refused_in_one_line():
    """Corpus: files that once ended the process, hung or raised something else than an `InputError`."""
    corpus = [Task(p.parent.name, file=p) for p in sorted(CORPUS.glob("*/*"))]
    assert len(corpus) >= 15
    out = fuzz([*corpus, *tasks_of(KINDS, EACH * len(KINDS), seed=1000)])
    assert not out.finds, "\n".join(f"{task}: {what}" for task, what in out.finds)
    for kind in KINDS:
        both = [out.counts[kind, what] for what in ("read", "refused")]
        assert sum(both) >= EACH and both[0] >= EACH // 100
    assert sum(n for (_, what), n in out.counts.items() if what == "refused") > 4 * EACH
