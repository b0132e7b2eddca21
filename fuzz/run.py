"""Coverage-guided fuzzing of the readers: `python fuzz/run.py csv|toml|mcap|rdt [options of
libFuzzer]`.

A reader may take a file or refuse it in one line that begins with the file's name. Anything else
stops the run, and leaves the content that did it in the folder.
"""

import os
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import atheris

with atheris.instrument_imports(include=["vibrissa", "rosbags", "tomllib"]):
    from targets import TARGETS

    target = TARGETS[sys.argv[1]]()

FOLDER = TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None)
FILE = Path(FOLDER.name) / f"fuzzed{target.suffix}"


def one(content: bytes) -> None:
    """Read one file."""
    FILE.write_bytes(content)
    try:
        target.read(FILE)
    except* ValueError as refusals:
        for refusal in refusals.exceptions:
            message = str(refusal)
            if target.suffix != ".bin" and not message.startswith(str(FILE)):
                raise AssertionError(f"no name of the file: {message}") from refusal
            if (
                len(message.splitlines()) != 1
                or len(message) > 2000
                or ("allowed" not in message and "holds" not in message)
            ):
                raise AssertionError(f"no clear error: {message}") from refusal


def main() -> None:
    """Fuzz until the options say that it is enough."""
    warnings.simplefilter("ignore")
    corpus = Path(FOLDER.name) / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(target.seeds):
        (corpus / f"seed{number}").write_bytes(seed)
    options = sys.argv[2:]
    of_files = any(not option.startswith("-") for option in options)
    atheris.Setup([sys.argv[0], *options, *([] if of_files else [str(corpus)])], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
