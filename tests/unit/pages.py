"""Code blocks of a page of Markdown, and the commands in them."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks_of(page: Path) -> list[tuple[str, str]]:
    """Language and text of each block."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


def commands_of(body: str) -> Iterator[list[str]]:
    """The words of each `vibrissa …` of a shell block; what installs or tests is passed over."""
    for line in body.replace("\\\n", "").splitlines():
        for command in line.split("&&"):
            words = shlex.split(command, comments=True)
            if words[:2] == ["uv", "run"]:
                words = words[2:]
            if words[0] == "vibrissa":
                yield [word for word in words[1:] if word != "&"]
            else:
                assert words[0] == "pytest" or "pip" in words, command
