"""Weight of `src` in tokens, by room: names, numbers, strings and operators, without comments,
docstrings and layout. `python benchmarks/weight.py [FOLDER]`.
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

COUNTED = (tokenize.NAME, tokenize.NUMBER, tokenize.STRING, tokenize.OP)


def _body(node: ast.AST) -> list[ast.stmt]:
    body = getattr(node, "body", None)
    return body if isinstance(body, list) else []


def weight(source: str) -> int:
    """Tokens of one file, as in Python 3.11, where an f-string is one token."""
    docstrings = {
        (statement.lineno, statement.col_offset)
        for node in ast.walk(ast.parse(source))
        for statement in _body(node)
        if isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    }
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return sum(token.type in COUNTED and token.start not in docstrings for token in tokens)


def main(folder: Path) -> int:
    """Print the table; return the sum."""
    rooms: Counter[str] = Counter()
    for path in sorted(folder.rglob("*.py")):
        rooms[path.relative_to(folder).parts[0]] += weight(path.read_text(encoding="utf-8"))
    for room, tokens in rooms.most_common():
        print(f"{tokens:8,d}  {room}")
    print(f"{rooms.total():8,d}  in all")
    return rooms.total()


if __name__ == "__main__":
    default = Path(__file__).parents[1] / "src" / "vibrissa"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
