"""The light state that a command works in."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from iris_addon.base.errors import BadInput
from iris_addon.model.capture import View
from iris_addon.results.records import read_light_states
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


def state_of_frames(args: argparse.Namespace, views: Sequence[View]) -> dict[str, str]:
    """What tells frames of ``views`` in one light state from those in another, for the record beside them."""
    named = {view.light_state for view in views}
    state = args.light_state or (next(iter(named)) if len(named) == 1 else "")
    return {"light_state": state} if state else {}


def state_of_photo(args: argparse.Namespace) -> str | None:
    """The light state of the photo ``args.view`` that ``composite`` puts something onto; None in a room of one.

    Raises:
        BadInput: it is not known, none of those solved, or another than the one that is asked for.
    """
    states = _states(args)
    if not states:
        return None
    known = ", ".join(states)
    taken_in = next((name for name, photos in states.items() if args.view in photos), args.light_state)
    if taken_in is None:
        what = f"has no photo {args.view!r} whose light state is known"
        raise BadInput(what, f"name the state of the photo with --light-state: {known}", args.result)
    if taken_in not in states:
        fix = f"put objects into photos of a light state that was solved: {known}"
        raise BadInput(f"was not solved in the light state {taken_in!r}", fix, args.result)
    if args.light_state not in (None, taken_in):
        what = f"has the photo {args.view!r} in the light state {taken_in!r}, not {args.light_state!r}"
        raise BadInput(what, "leave out --light-state, or clear the camera's light state", args.result)
    return taken_in


def state_of_plate(args: argparse.Namespace) -> str | None:
    """The light state of the plate that ``composite`` puts something onto: as asked for, else the first; None in a room
    of one.

    Raises:
        BadInput: there is no such state.
    """
    states = _states(args)
    if not states:
        return None
    if args.light_state not in (None, *states):
        fix = f"name one of its states: {', '.join(states)}"
        raise BadInput(f"was not solved in the light state {args.light_state!r}", fix, args.result)
    return args.light_state or next(iter(states))


def _states(args: argparse.Namespace) -> dict[str, tuple[str, ...]]:
    """Photos by light state of the room; empty in a room of one, where BadInput is raised if a state is asked for."""
    states = read_light_states(args.result)
    if not states and args.light_state is not None:
        fix = "leave out --light-state"
        raise BadInput(f"was photographed in one light state only, not in {args.light_state!r}", fix, args.result)
    return states
