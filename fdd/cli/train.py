"""``fdd train``: what a data set's healthy and faulty logs teach of the evidence."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fdd.cli.options import WorkersOption, argument, option, require_packages
from fdd.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from fdd.campaign.train import ScoredLog


Target = Literal["family", "fault"]


def train(
    datasets: Annotated[list[Path], argument("Folders that fdd generate made.")],
    out: Annotated[Path, option("Model file (JSON), or classifier file (.skops).", "--out", "-o")],
    classifier: Annotated[
        str | None,
        option(
            "Train a classifier of scikit-learn's kind instead: logistic, boosting, of an installed "
            "package, or what a function returns.",
            metavar="NAME|MODULE:FUNCTION",
        ),
    ] = None,
    target: Annotated[Target, typer.Option(help="What a classifier is to tell.")] = "family",
    spreads: Annotated[
        bool,
        typer.Option(
            "--spreads/--no-spreads",
            help="Learn as well what healthy units and logs differ by, instead of taking fdd's own; "
            "from 20 units on, with twins best.",
        ),
    ] = False,
    workers: WorkersOption = None,
) -> None:
    """Learn from data sets how often healthy logs reach a score, and what a score is worth."""
    from fdd.files import require_writable

    require_writable(out)
    if classifier is not None:
        _train_classifier(classifier, datasets, out, target, workers)
        return

    from fdd.campaign.train import train as fit
    from fdd.cli.console import counted, output

    count = workers or os.cpu_count() or 1
    found = None
    try:
        if spreads:
            from fdd.campaign.learning_spreads import learn_spreads

            with counted("what healthy logs differ by") as step:
                found = learn_spreads([str(d) for d in datasets], workers=count, progress=step)
        with counted("training") as step:
            model, logs = fit(datasets, workers=count, progress=step, spreads=found)
    except InputError as error:
        raise (error if error.where else error.at(datasets[0])) from None
    from fdd.campaign.scores import rate

    model.save(out)
    output().print(confusion_table(logs))
    tail = model.tail
    passed = rate(round(tail.rate_per_hour * tail.hours), tail.hours)
    print(
        f"Healthy: scores pass {0.5 * tail.height**2:.1f} {passed}, 95 %, and {tail.threshold(1.0):.1f} once."
    )
    print(
        f"Where one log in {1.0 / model.calibration.prior:.0f} is faulty, one with a score of "
        f"{model.calibration.even:.1f} is so as likely as not."
    )
    print(f"Model written to {out}")


def _train_classifier(
    name: str, datasets: list[Path], out: Path, target: Target, workers: int | None
) -> None:
    require_packages("research", "skops")

    from fdd.campaign.classifiers import made, train_classifier
    from fdd.campaign.loading import with_features
    from fdd.cli.console import counted, output, remark
    from fdd.learning.stored import load_classifier, save_classifier

    made(name)  # refused before minutes are spent on features
    sets = []
    for folder in datasets:
        with counted(f"features of {folder.name}") as step:
            sets.append(with_features(folder, workers=workers, progress=step))
    stored, judged = train_classifier(name, sets, target)
    save_classifier(stored, out)
    output().print(_counts(judged.confusion, f"Held-out rows by true {target} and answer"))
    print(
        f"On {judged.rows} rows of {judged.units} units that it has not seen: "
        f"accuracy {judged.accuracy:.2f}, macro-F1 {judged.macro_f1:.2f}, "
        f"Brier score {judged.brier:.2f} (0 is best, 2 worst)."
    )
    print(
        f"fdd's own answers on them: accuracy {judged.own_accuracy:.2f}, macro-F1 {judged.own_macro_f1:.2f}."
    )
    print(f"Classifier written to {out}")
    try:
        load_classifier(out)
    except InputError as error:
        remark(f"fdd diagnose will refuse it: {error}")


def confusion_table(logs: list[ScoredLog]) -> Table:
    """Logs by true family (rows) and answer (columns), and the share that is right with its 95 % interval."""
    import pandas as pd

    from fdd.campaign.scores import wilson

    families = sorted({x.family for x in logs})
    answers = [*sorted({x.answer for x in logs if x.answer}), ""]
    counts = {a: [sum(x.family == f and x.answer == a for x in logs) for f in families] for a in answers}
    right = []
    for k, family in enumerate(families):
        hits = counts.get("" if family == "healthy" else family, [0] * len(families))[k]
        right.append(wilson(hits, sum(x.family == family for x in logs)))
    return _counts(pd.DataFrame(counts, index=families), "Logs by true family and answer", right)


def _counts(counts: pd.DataFrame, title: str, right: list[str] | None = None) -> Table:
    """Logs by what they are (rows) and what was answered (columns); `right` : a last column."""
    from fdd.cli.console import grid

    names = [name.replace("_", " ") or "no alarm" for name in counts.columns]
    rows = [
        [str(true).replace("_", " "), *(str(c) if c else "·" for c in row)]
        for true, row in zip(counts.index, counts.to_numpy().tolist(), strict=True)
    ]
    if right is not None:
        rows = [[*row, share] for row, share in zip(rows, right, strict=True)]
        names.append("right, 95 %")
    return grid(("true", *names), rows, numbers=names, title=title)
