"""The page of ``doctor --report``: the profile, its checks, its drift, and what was converted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from hframe_post.hosts.moonraker.conversion import page_of
from hframe_post.hosts.moonraker.disk import MAX_TEXT_CHARACTERS, Event
from hframe_post.page.charts import WARNING, Card, Chart, Curve, Section, page
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import duration

DAY_S = 24 * 3600.0  # s
STALE_DAYS = 90  # days, from which a model is to be checked
NOTABLE_DRIFT_PERCENT = (
    5.0  # %, by which a frequency drifts if a belt has lost a tenth of its tension
)
AXIS = "days (today is 0)"
MOST_CHECKS, MOST_PRINTS = 20, 50  # that are listed
Points = Sequence[tuple[float, float]]


def history_page(
    name: str, profile: Printer | None, findings: Sequence[tuple[str, str]],
    events: Sequence[Event], now: datetime,
) -> bytes:  # fmt: skip
    """Return the page as HTML. profile: None if it cannot be used.

    findings: of ``doctor``, with their labels. events: the oldest first.
    """
    checks = [event for event in events if event.kind in ("calibration", "check")]
    prints = [event for event in events if event.kind == "conversion"]
    courses = {axis: _course(checks, axis) for axis in sorted({a for e in checks for a in e.hz})}
    notes = [f"{WARNING if kind == 'PROBLEM' else kind}  {text}" for kind, text in findings]
    drift = [_curve(axis, _changes(course), now) for axis, course in courses.items()]
    sections = [
        Section("Drift", [Chart("Change of the resonances", AXIS, "%", drift)] if drift else [],
                [_check(event) for event in checks[: -MOST_CHECKS - 1 : -1]]),
        Section("Prints", _errors(prints, now),
                [_print(event) for event in prints[: -MOST_PRINTS - 1 : -1]]),
    ]  # fmt: skip
    return page(
        name, "The printer's model, its checks, and the files that were converted.",
        [*(_state(profile, now) if profile else ()), _last(checks, now), *_drifts(courses)],
        [section for section in sections if section.rows], notes,
        [("made", f"{now:%Y-%m-%d %H:%M} UTC"), *(_facts(profile) if profile else ())],
    )  # fmt: skip


def _state(profile: Printer, now: datetime) -> Iterator[Card]:
    """Yield the cards of a profile: age, uncertainty, and whether it was verified."""
    day, verified = profile.measured, profile.verified
    if profile.invented:
        yield Card("Model measured", "never", more="HFRAME_CALIBRATE measures it", kind="bad")
        return
    if day is None:
        yield Card("Model measured", "unknown", more="the profile does not say when")
    else:
        age = (now.date() - day).days
        yield Card("Model measured", *_ago(age), f"on {day}", "bad" if age > STALE_DAYS else "")
    uncertain = 100.0 * profile.uncertainty_on(now.date())
    value, unit = (f"±{uncertain:.1f}", "%") if uncertain else ("unknown", "")
    yield Card("Uncertainty today", value, unit, "of the resonances")
    if verified:
        less = f"{100.0 * verified.reduction:.0f}"
        yield Card("Verified", less, "% less error", f"on {verified.date}", "best")
    else:
        yield Card("Verified", "no", more="to verify: hframe-post measure --for verify")


def _last(checks: Sequence[Event], now: datetime) -> Card:
    """Return the card of the last measurement."""
    if not checks:
        return Card("Last check", "none", more="HFRAME_CHECK makes one")
    last = checks[-1]
    days = int((now.timestamp() - last.at) / DAY_S)
    return Card("Last check", *_ago(days), last.reason or last.kind, "bad" if last.reason else "")


def _ago(days: int) -> tuple[str, str]:
    return ("today", "") if days < 1 else (f"{days}", "day ago" if days == 1 else "days ago")


def _drifts(courses: dict[str, Points]) -> Iterator[Card]:
    """Yield the card of each axis that was measured more than once."""
    for axis, course in courses.items():
        if len(course) > 1:
            (since, first), (_, last) = course[0], course[-1]
            _, moved = _changes(course)[-1]
            more = f"{first:.1f} → {last:.1f} Hz since {_day(since)}"
            value = f"{moved:+.1f}".replace("-", "−")
            yield Card(
                f"Drift of {axis}",
                value,
                "%",
                more,
                "bad" if abs(moved) > NOTABLE_DRIFT_PERCENT else "",
            )


def _changes(course: Points) -> Points:
    """Return the changes since the first frequency, in %."""
    _, first = course[0]
    return [(at, 100.0 * (hz / first - 1.0)) for at, hz in course]


def _facts(profile: Printer) -> list[tuple[str, str]]:
    return [
        ("profile", f"{profile.name}: {profile.description}"),
        ("kinematics", profile.kinematics.type),
        ("firmware", profile.firmware.dialect),
        ("settings", profile.digest),
    ]


def _check(event: Event) -> tuple[str, str]:
    found = "; ".join(
        f"{axis} " + " → ".join(f"{hz:.1f}" for hz in values) + " Hz"
        for axis, values in event.hz.items()
    )
    return _day(event.at), f"{event.kind}: {event.reason or found or 'no resonance'}"


def _print(event: Event) -> tuple[str, str] | tuple[str, str, str]:
    errors = " → ".join(f"{error:.1f}" for error in event.rms_um)
    times = " → ".join(duration(seconds) for seconds in event.seconds)
    known = (event.name, f"{errors} µm RMS" if errors else "no motion", times)
    row = _day(event.at), ", ".join(part for part in known if part)
    # a longer name was cut
    return (*row, page_of(event.name)) if len(event.name) < MAX_TEXT_CHARACTERS else row


def _course(checks: Sequence[Event], axis: str) -> Points:
    """Return times and frequencies of an axis.

    A check measures the peak of the response, which damping moves away from a mode's frequency. So
    a calibration counts with the peak that the check after it found in its model.
    """
    found = [event for event in checks if event.hz.get(axis)]
    points = [
        (one.at, after.hz[axis][0] if (one.kind, after.kind) == ("calibration", "check")
         else one.hz[axis][-1])
        for one, after in pairwise(found)
    ]  # fmt: skip
    return [*points, *((event.at, event.hz[axis][-1]) for event in found[-1:])]


def _errors(prints: Sequence[Event], now: datetime) -> list[Chart]:
    """Return the chart of the predicted errors."""
    known = [event for event in prints if len(event.rms_um) > 1]
    if not known:
        return []
    sliced, ours = ([(event.at, event.rms_um[k]) for event in known] for k in (0, -1))
    lines = [
        _curve("as sliced", sliced, now, "var(--none)"),
        _curve("compensated", ours, now, "var(--racking)"),
    ]
    return [Chart("Predicted contour error", AXIS, "µm RMS", lines, (False, True))]


def _curve(label: str, points: Points, now: datetime, colour: str | None = None) -> Curve:
    at, values = np.array(points).T
    return Curve(label, (at - now.timestamp()) / DAY_S, values, colour, strong=True)


def _day(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).date().isoformat()
