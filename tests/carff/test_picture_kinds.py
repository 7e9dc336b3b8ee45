"""Which pictures have one right decision."""

from dataclasses import replace

import torch

from carff.picture_kinds import PictureKinds, picture_kinds


def kinds_of(evaluation) -> PictureKinds:
    views, table = evaluation.views, evaluation.table
    return picture_kinds(views.state, views.picture, table.known_hazard(), table.successor)


def places(evaluation, kind) -> set[tuple[int, int]]:
    views = evaluation.views
    return set(zip(views.state[kind].tolist(), views.camera[kind].tolist()))


def with_hazard(evaluation, *flags: bool):
    return replace(evaluation, table=replace(evaluation.table, hazard=torch.tensor(flags)))


def test_kinds_of_pictures(tiny_evaluation):
    kinds = kinds_of(tiny_evaluation)
    # Last steps have no forecast: only state 0 (absent t0) and state 2 (present t0) count.
    assert places(tiny_evaluation, kinds.hidden) == {(2, 0)}
    assert places(tiny_evaluation, kinds.shown) == {(2, 1), (2, 2), (2, 3)}
    assert places(tiny_evaluation, kinds.clear) == {(0, 1), (0, 2), (0, 3)}


def test_states_whose_flag_changes_with_the_next_step_are_left_out(tiny_evaluation):
    kinds = kinds_of(with_hazard(tiny_evaluation, False, True, True, True))
    for kind in (kinds.hidden, kinds.shown, kinds.clear):
        assert not places(tiny_evaluation, kind) & {(0, 1), (0, 2), (0, 3)}


def test_a_picture_that_fits_a_state_which_turns_hazardous_is_not_clear(tiny_evaluation):
    # State 2 (now safe) turns hazardous; state 0 at camera 0 gives the same picture and stays safe.
    turning = with_hazard(tiny_evaluation, False, False, False, True)
    assert places(turning, kinds_of(turning).clear) == {(0, 1), (0, 2), (0, 3)}


def test_a_picture_that_only_a_last_step_shares_is_neither_hidden_nor_shown(tiny_evaluation):
    views = tiny_evaluation.views
    # State 2 at camera 0 looks like the last absent step (1) now, and like nothing else.
    picture = views.picture.clone()
    at = {(int(s), int(c)): row for row, (s, c) in enumerate(zip(views.state, views.camera))}
    picture[at[2, 0]] = picture[at[1, 0]]
    kinds = kinds_of(replace(tiny_evaluation, views=replace(views, picture=picture)))
    assert (2, 0) not in places(tiny_evaluation, kinds.hidden | kinds.shown)
