"""Write measured numbers, and tables of what the code holds, into the pages, where they stand
between `<!-- = name -->` and `<!-- . -->`: a page is complete wherever it is read.
"""

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from conf import VALUES  # noqa: E402

_PLACE = re.compile(r"(<!-- = (\w+) -->)(.*?)(<!-- \. -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with its values."""

    def put(found: re.Match[str]) -> str:
        value = VALUES[found[2]]
        return f"{found[1]}\n{value}\n{found[4]}" if "\n" in value else found[1] + value + found[4]

    return _PLACE.sub(put, text)


if __name__ == "__main__":
    for page in HERE.glob("**/*.md"):
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
