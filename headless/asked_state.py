"""The light state that a command works in."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from iris_addon.base.errors import BadInput
from iris_addon.model.capture import View
from iris_addon.results.result import Result


def in_asked_state(args: argparse.Namespace, result: Result, views: Sequence[View]) -> Result:
    """The room in the light state that is asked for, else in that of the views where they have one, else in the first.

    Raises:
        BadInput: the room has no such state, or photos that something is put into show several.
    """
    named = {view.light_state for view in views}
    if getattr(args, "onto_photos", False) and result.light_states:
        known = {state.name for state in result.light_states}
        if len(named) > 1:
            fix = "render those of one at a time with --only"
            raise BadInput("has photos of several light states", fix, args.views)
        if not named <= known or args.light_state not in (None, *named):
            fix = "put objects into photos of a light state that was solved, under that state"
            raise BadInput(f"has photos of the light state {next(iter(named), '')!r}", fix, args.views)
    if args.light_state is None and len(named) == 1:
        known = {state.name for state in result.light_states}
        return result.in_state(next(iter(named & known), None))
    return result.in_state(args.light_state)
