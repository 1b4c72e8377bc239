"""YAML documents, as `ros2 topic echo --full-length` prints messages: one after each `---`.

Aliases are refused: a few of them stand for more than any memory holds.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import yaml

from sg3d_jax.io.files import MAX_DOCUMENT, read_text

SUFFIXES: Final = (".yaml", ".yml")
MAX_OPENED: Final = 20_000  # brackets and braces of a file, which its reader counts again and again
ELLIPSIS: Final = "..."  # what `ros2 topic echo` prints in the place of what it leaves out
_Loader: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the former is ten times as fast


def read_yaml(path: str | Path) -> Iterator[tuple[str, Any]]:
    """Yields the documents of a YAML file that are not empty.

    Args:
      path: the file.

    Yields:
      A pair for each document: where it is, as an error should name it, and the document.

    Raises:
      ValueError: the file cannot be read, or has aliases; there is no document; or a message was
        cut short when it was printed.
    """
    text = read_text(path)
    if len(text) > MAX_DOCUMENT:
        expected = f"expected {MAX_DOCUMENT} at most"
        raise ValueError(f"{path}: the file has {len(text)} characters, {expected}")
    if (opened := text.count("[") + text.count("{")) > MAX_OPENED:
        expected = f"expected {MAX_OPENED} at most"
        raise ValueError(f"{path}: the file has {opened} brackets and braces, {expected}")
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=_Loader)):
            raise ValueError(f"{path}: there is an alias, expected every value where it belongs")
        documents = [one for one in yaml.load_all(text, Loader=_Loader) if one is not None]
    except (yaml.YAMLError, RecursionError) as error:
        said = " ".join(f"{error}".split())
        raise ValueError(f"{path}: not YAML that can be read ({said:.80})") from error
    if not documents:
        raise ValueError(f"{path}: the file is empty, expected a message")
    for index, document in enumerate(documents):
        where = f"{path}: message {index}" if len(documents) > 1 else f"{path}"
        if _is_cut(document):
            instead = "ros2 topic echo --full-length"
            raise ValueError(f"{where}: lists were cut short, expected what {instead} prints")
        yield where, document


def _is_cut(value: Any) -> bool:
    if isinstance(value, dict):
        return any(map(_is_cut, value.values()))
    if isinstance(value, list):
        return ELLIPSIS in value or any(map(_is_cut, value))
    return False
