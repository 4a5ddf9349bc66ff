"""A blind check as a page: what was right, confused and missed, with intervals."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapscope.arm.io.atomic_write import write_text
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.nearest_name import shortened
from gapscope.blind_check.scoring import Compared
from gapscope.diagnosis.document.wording import Document
from gapscope.reports.pages import (
    PageSection,
    drawn,
    figure_html,
    with_bars,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# The truth of a set of cases in lines of text, to look at the generator.


def truth_lines(labels: Path) -> Iterator[str]:
    """One line per case: what it is, its severity and its conditions."""
    for name, label in read_json(labels, "give the labels")["cases"].items():
        effects = (
            " + ".join(
                f"{e.get('kind', e['effect'])}{e['joints'] or ''}"
                for e in label["effects"]
            )
            or "healthy"
        )
        c = label["conditions"]
        # without an effect there is no gap of its own
        ratio = "-" if label["ratio"] is None else f"{label['ratio']:.2f}"
        yield (
            f"{name} {label['kind']:8s} {c['robot']:12s} {c['rate']:4d} Hz {effects:60s} ratio {ratio:>6s} "
            f"floor {max(label['floor']):.4f} off {c['inertials_off']:.2f} noise x{c['noise']:.0f} "
            f"{'bare' if c['bare'] else label['feedforward']}, {label['attempts']} draws"
        )


# The tables of a blind check: rows of text, rendered as Markdown or on a terminal.


BRIEFLY = ("Effects named", "Verdicts and probabilities", "Beside plain methods")
"""Titles of the tables that a terminal shows; the files have all of them."""


def brief_tables(figures: Document) -> list[PageSection]:
    """Those of a terminal, without the counts of shares."""
    shown = [table for table in tables(figures) if table.title in BRIEFLY]
    return [
        # counts would not fit beside the shares
        replace(table, rows=[[re.sub(r", \d+ of \d+$", "", cell) for cell in row] for row in table.rows])
        for table in shown
    ]  # fmt: skip


def tables(figures: Document) -> list[PageSection]:
    """All tables of a blind check."""
    kinds = figures["by_kind"].items()
    # of these nothing can be named right
    caught = {k: v for k, v in kinds if k not in ("healthy", "outside")}
    groups = {
        "Effects named": caught,
        "Single effects over severity (own gap over the floor)": figures["by_severity"],
        "Single effects, severity 3 to 20": figures["by_effect"],
        "Nominal inertials": figures["by_inertials"],
        "Controller": figures["by_controller"],
        "Rate of the recordings": figures["by_rate"],
        "Arm": figures["by_robot"],
    }
    # a set without such cases has no such table
    main, *others = [_scores(title, own) for title, own in groups.items() if own]
    calibration, confusion = figures["calibration"], figures["confusion"]
    found = [main, _verdicts(figures), *others]
    rows = [
        (
            f"{r['from']:.1f} to {r['to']:.1f}",
            str(r["count"]),
            f"{r['probability']:.3f}",
            f"{r['right']:.3f}",
        )
        for r in calibration["reliability"]
    ]
    heads = ("probability", "findings", "mean probability", "share right")
    found += [PageSection("Reliability", heads, rows), _confusion(confusion)]
    return [*found, _baselines(figures)] if "baselines" in figures else found


def _scores(title: str, groups: Document) -> PageSection:
    columns: dict[str, tuple[str, Callable[[Any], str]]] = {
        "cases": ("count", str),
        "top-1": ("top", rate),
        "exact set": ("exact", rate),
        "exact, strictly": ("exact_strict", rate),
        "Jaccard": ("jaccard", _number),
        "joints": ("joints", rate),
        "called unexplained": ("called_unexplained", rate),
        "first parameter, median error": ("parameter_error", _median),
        "in its interval": ("intervals", rate),
        "gap closed, median": ("gap_closed", _median),
        "worst joint, median": ("gap_closed_worst_joint", _median),
    }
    rows = [
        [name, *(text(scores[key]) for key, text in columns.values())]
        for name, scores in groups.items()
    ]
    return PageSection(title, ("", *columns), rows)


def _verdicts(figures: Document) -> PageSection:
    well, beyond, calibration = (
        figures[key] for key in ("healthy", "unknown", "calibration")
    )
    sets, fixed = calibration["sets"], figures["frozen"]
    # of a run that did not end neither is known
    source, changed = ("–", "–")
    if fixed["complete"]:
        source = "yes" if fixed["source_changed_during_the_run"] else "no"
        changed = shortened(fixed["changed_after_the_run"]) or "none"
    rows = {
        "run complete": "yes" if fixed["complete"] else "no",
        "source changed during the run": source,
        "diagnoses changed after the run": changed,
        "false alarms on healthy arms": rate(well["false_alarms"]),
        "healthy arms with an effect named": rate(well["effects_named"]),
        "outside the catalogue called unexplained": rate(beyond["recall"]),
        "inside the catalogue called unexplained": rate(beyond["false_unknown"]),
        "Brier score of the probabilities": _number(calibration["brier"]),
        "expected calibration error": _number(calibration["ece"]),
        f"sets at {sets['level']:.0%} that hold the truth": rate(sets["coverage"]),
        "mean size of these sets": _number(sets["mean_size"]),
        "diagnoses that failed": str(len(figures["failed"])),
        "seconds of a diagnosis, median": _median(figures["seconds"], percent=False),
    }
    return PageSection("Verdicts and probabilities", ("", ""), list(rows.items()))


def _confusion(confusion: dict[str, dict[str, int]]) -> PageSection:
    rows = []
    # a row for each truth, its answers with their numbers
    for truth, answers in confusion.items():
        listed = ", ".join(f"{answer} {count}" for answer, count in answers.items())
        rows.append((truth, str(sum(answers.values())), listed))
    title = "Confusion: what single causes were taken for"
    return PageSection(title, ("truth", "cases", "first answer"), rows)


def _baselines(figures: Document) -> PageSection:
    kinds = {
        "single top-1": ("single", "top"),
        "single exact": ("single", "exact"),
        "pair exact": ("pair", "exact"),
        "triple Jaccard": ("triple", "jaccard"),
        "ladder exact": ("ladder", "exact"),
    }
    alarms = {
        "false alarms on healthy arms": ("healthy", "false_alarms"),
        "outside called unexplained": ("unknown", "recall"),
        "inside called unexplained": ("unknown", "false_unknown"),
    }
    rows = []
    for name, method in {"this diagnosis": figures, **figures["baselines"]}.items():
        # not every method was tried on every kind
        values = [method["by_kind"].get(a, {}).get(b) for a, b in kinds.values()]
        values += [method[a][b] for a, b in alarms.values()]
        shown = [rate(x) if isinstance(x, dict) else _number(x) for x in values]
        rows.append([name, *shown])
    return PageSection("Beside plain methods", ("method", *kinds, *alarms), rows)


def rate(share: Document) -> str:
    """``95 % (90..98), 57 of 60``; a dash without cases."""
    if not share["count"]:
        return "–"
    return (
        f"{100 * share['rate']:.0f} % ({100 * share['low']:.0f}..{100 * share['high']:.0f}), "
        f"{share['hits']} of {share['count']}"
    )


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _median(quantiles: dict[str, float] | None, *, percent: bool = True) -> str:
    if quantiles is None:
        return "–"
    return (
        f"{100 * quantiles['median']:.1f} %"
        if percent
        else f"{quantiles['median']:.1f}"
    )


# The pictures of a blind check: accuracy over severity, reliability, confusion.


QUANTITIES = {"top": "top-1", "exact": "exact set", "joints": "joints"}
"""Shares that are drawn over severity, and their names."""


def severity_figure(figures: Document) -> Figure:
    """Shares with Wilson's intervals over severity classes of single effects."""
    import pandas as pd

    shares = [
        {"class": group, "quantity": name, "value": scores[key]["rate"], **scores[key]}
        for key, name in QUANTITIES.items()
        for group, scores in figures["by_severity"].items()
    ]
    # a set without single effects has no class
    columns = ("class", "quantity", "value", "low", "high")
    return drawn(
        "line",
        # a class without cases is drawn at zero
        with_bars(pd.DataFrame(shares, columns=columns)).fillna({"value": 0.0}),
        {"class": "own gap over the floor", "value": "share right"},
        error_y="above",
        error_y_minus="below",
        color="quantity",
        markers=True,
        range_y=(0, 1.02),
    )


def reliability_figure(figures: Document) -> Figure:
    """Share of findings that are right over their probability, beside the diagonal."""
    line = [
        {"of": "calibrated", "probability": p, "right": p, "count": None}
        for p in (0.0, 1.0)
    ]
    found = [{"of": "findings", **row} for row in figures["calibration"]["reliability"]]
    return drawn(
        "line",
        [*line, *found],
        {"probability": "probability", "right": "share right"},
        color="of",
        line_dash="of",
        line_dash_sequence=("dot", "solid"),
        markers=True,
        hover_data=["count"],
    )


def confusion_figure(figures: Document) -> Figure:
    """Truth against first answer, numbers of cases."""
    import pandas as pd
    import plotly.express as px

    counts = pd.DataFrame(figures["confusion"]).T.sort_index(axis=1)
    return px.imshow(
        counts.fillna(0),
        labels={"x": "first answer", "y": "truth", "color": "cases"},
        text_auto=True,
        aspect="auto",
    )


# Writing a blind check: ``score.json``, ``score.md`` and ``score.html``, which opens offline.


FIGURES = {
    "severity": ("Single effects over severity", severity_figure, 460),
    "reliability": ("Reliability", reliability_figure, 460),
    "confusion": ("Confusion", confusion_figure, 900),
}
"""Figures by name, each with its title, its maker and its height [pixels]."""


def write_score(
    figures: Document, cases: Iterable[Compared], folder: Path
) -> tuple[Path, ...]:
    """Write the figures, the tables and the pictures; each file whole or not at all.

    Returns:
        ``score.json``, ``score.md`` and ``score.html``.

    Raises:
        GapscopeError: a file cannot be written.
    """
    document, text, page = (
        folder / f"score.{ending}" for ending in ("json", "md", "html")
    )
    verdicts = [asdict(case) for case in cases]
    write_json({**figures, "verdicts": verdicts}, document)
    shown = tables(figures)
    content = "\n".join(table.markdown() for table in shown)
    write_text(text, f"# Blind check\n\n{content}")
    sections = [*shown]
    for name, (title, make_figure, height) in FIGURES.items():
        figure = figure_html(make_figure(figures), name, height)
        sections.append(PageSection(title=title, figure=figure))
    # the script of lines and bars draws no maps of colours
    write_plot_page(page, "Blind check", "", sections, whole=True)
    return document, text, page
