"""English names of Greek letters are read as letters where they stand alone; dots and wide letters keep columns."""

import pytest

from platform_ctrl.common.text import dotted, greek, padded, width


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("alpha4", "α4"),
        ("q_theta", "q_θ"),
        ("p_beta10", "p_β10"),
        ("Omega1", "Ω1"),
        ("eta", "η"),
        # No letter of its own: what stands before or behind it belongs to the word.
        ("zeta", "ζ"),
        ("beta_meta", "β_meta"),
        ("tenu3", "tenu3"),
        ("axi", "axi"),
        ("nut", "nut"),
        ("muon_1", "muon_1"),
        ("roll", "roll"),
    ],
)
def test_only_whole_words_are_letters(name, shown):
    assert greek(name) == shown


def test_dots_take_no_column_and_wide_letters_two():
    assert [width(dotted("alpha4", k)) for k in range(3)] == [2, 2, 2]
    assert width("軸1") == 3
    assert padded(dotted("alpha4", 2), 5) == dotted("alpha4", 2) + "   "
    assert padded("alpha4", 3) == "alpha4"
