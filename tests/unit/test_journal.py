"""The style of figures: only its own settings are put back."""

import matplotlib as mpl

from vibrissa.plot import journal


def test_what_changes_within_stays_unless_it_is_of_the_style() -> None:
    before = dict(mpl.rcParams)
    try:
        with journal():
            assert mpl.rcParams["font.family"] != before["font.family"]
            # As the backend of a notebook does when the first figure is made.
            mpl.rcParams["interactive"] = not before["interactive"]
        assert mpl.rcParams["interactive"] != before["interactive"]
        assert mpl.rcParams["font.family"] == before["font.family"]
        assert mpl.rcParams["font.size"] == before["font.size"]
    finally:
        mpl.rcParams["interactive"] = before["interactive"]
