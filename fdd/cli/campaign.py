"""``fdd generate``, ``features``, ``train`` and ``validate``: labelled data sets, and what they teach."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from fdd.cli import command
from fdd.cli.command import argument, option, require_packages
from fdd.errors import InputError
from fdd.files import require_writable, write_text, written

Target = Literal["family", "fault"]


def generate(
    recipe: Annotated[Path, argument("Recipe of the campaign (YAML).")],
    out: Annotated[Path, option("Folder of the data set.", "--out", "-o")],
    workers: command.WorkersOption = None,
    units: Annotated[int | None, option("Units, instead of the recipe's.", min=1)] = None,
    logs: Annotated[int | None, option("Logs of each unit, instead of the recipe's.", min=0)] = None,
    twins: Annotated[
        bool | None,
        option("Each faulty log once more without its faults, instead of the recipe's; twice the time.",
               "--twins/--no-twins"),
    ] = None,
    engine: command.EngineOption = "local",
) -> None:  # fmt: skip
    """Generate a labelled data set of simulated runs."""
    require_writable(out, folder=True)

    from fdd.campaign.generate import generate as run
    from fdd.campaign.recipe import Recipe
    from fdd.cli.console import counted

    given = {"units": units, "logs_per_unit": logs, "twins": twins}
    asked = {name: value for name, value in given.items() if value is not None}
    campaign = Recipe(**{**Recipe.load(recipe).model_dump(by_alias=True), **asked})
    with counted(f"generating {out.name}") as step:
        run(campaign, out, workers=workers, engine=engine, progress=step)
    print(f"Data set written to {out}")


def features(
    dataset: command.DatasetArgument,
    out: Annotated[
        Path,
        option("Table to write; as features.parquet in the data set's folder it is found there.",
               "--out", "-o", metavar="FILE.parquet"),
    ],
    model: command.ModelOption = None,
    workers: command.WorkersOption = None,
    engine: command.EngineOption = "local",
) -> None:  # fmt: skip
    """Make a table of features and truth of a data set: a row for each log."""
    require_writable(out)

    from fdd.campaign.loading import feature_table, write_features
    from fdd.cli.console import counted

    with counted(f"features of {dataset.name}") as step:
        table = feature_table(dataset, model=model, workers=workers, engine=engine, progress=step)
    write_features(table, out)
    print(f"{table.num_rows} rows of {table.num_columns} columns written to {out}")


def validate(
    dataset: command.DatasetArgument,
    model: command.ModelOption = None,
    out: Annotated[Path | None, option("Folder for validation.md and outcomes.csv.", "--out", "-o")] = None,
    workers: command.WorkersOption = None,
    engine: command.EngineOption = "local",
) -> None:
    """Diagnose every log of a data set and compare with its truth."""
    if out is not None:
        require_writable(out, folder=True)

    from fdd.campaign.dataset import Dataset
    from fdd.campaign.validate import outcomes_csv, report_text, summary
    from fdd.campaign.validate import validate as run
    from fdd.cli.console import counted
    from fdd.diagnosis.model import Model

    data, asked = Dataset.load(dataset), Model.load(model)
    with counted(f"validating on {data.recipe.name}") as step:
        outcomes = run(dataset, asked, workers=workers, engine=engine, progress=step)
    print(summary(outcomes, asked), end="")
    if out is not None:
        with written(out):
            out.mkdir(parents=True, exist_ok=True)
        write_text(out / "validation.md", report_text(outcomes, data, asked))
        write_text(out / "outcomes.csv", outcomes_csv(outcomes))
        print(f"Written to {out}")


def train(
    datasets: Annotated[list[Path], argument("Folders that fdd generate made.")],
    out: Annotated[Path, option("Model file (JSON), or classifier file (.skops).", "--out", "-o")],
    classifier: Annotated[
        str | None,
        option("Train a classifier of scikit-learn's kind instead: logistic, boosting, of an installed "
               "package, or what a function returns.", metavar="NAME|MODULE:FUNCTION"),
    ] = None,
    target: Annotated[Target, typer.Option(help="What a classifier is to tell.")] = "family",
    spreads: Annotated[
        bool,
        typer.Option("--spreads/--no-spreads",
                     help="Learn as well what healthy units and logs differ by, instead of taking fdd's own; "
                     "from 20 units on, with twins best."),
    ] = False,
    workers: command.WorkersOption = None,
) -> None:  # fmt: skip
    """Learn from data sets how often healthy logs reach a score, and what a score is worth."""
    require_writable(out)
    if classifier is not None:
        _train_classifier(classifier, datasets, out, target, workers)
        return

    from fdd.campaign.scores import rate
    from fdd.campaign.spreads import learn_spreads
    from fdd.campaign.train import train as fit
    from fdd.cli.console import counted

    found = None
    try:
        if spreads:
            with counted("what healthy logs differ by") as step:
                found = learn_spreads(datasets, workers=workers, progress=step)
        with counted("training") as step:
            model = fit(datasets, workers=workers, progress=step, spreads=found)
    except InputError as error:
        raise (error if error.where else error.at(datasets[0])) from None
    model.save(out)
    tail, worth = model.tail, model.calibration
    passed = rate(round(tail.rate_per_hour * tail.hours), tail.hours)
    print(
        f"Healthy: scores pass {0.5 * tail.height**2:.1f} {passed}, 95 %, and {tail.threshold(1.0):.1f} once."
    )
    print(
        f"Where one log in {1.0 / worth.prior:.0f} is faulty, a log is called so from a score of "
        f"{worth.even:.1f} on; one healthy log in fifty reaches {worth.least:.1f}."
    )
    print(f"Model written to {out}")


def _train_classifier(
    name: str, datasets: list[Path], out: Path, target: Target, workers: int | None
) -> None:
    require_packages("research", "skops")

    from fdd.campaign.loading import with_features
    from fdd.campaign.train import made, train_classifier
    from fdd.cli.console import counted, remark
    from fdd.learning.stored import load_classifier, save_classifier

    made(name)  # refused before minutes are spent on features
    sets = []
    for folder in datasets:
        with counted(f"features of {folder.name}") as step:
            sets.append(with_features(folder, workers=workers, progress=step))
    stored, own = train_classifier(name, sets, target)
    save_classifier(stored, out)
    told = stored.figures
    print(
        f"On {told['rows']} rows of {told['units']} units that it has not seen: "
        f"accuracy {told['accuracy']:.2f}, macro-F1 {told['macro_f1']:.2f}, "
        f"Brier score {told['brier']:.2f} (0 is best, 2 worst)."
    )
    print(f"fdd's own answers on them: accuracy {own['accuracy']:.2f}, macro-F1 {own['macro_f1']:.2f}.")
    print(f"Classifier written to {out}")
    try:
        load_classifier(out)
    except InputError as error:
        remark(f"fdd diagnose will refuse it: {error}")
