"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def markdown_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], align: str = "r"
) -> list[str]:
    """Return the lines of a table.

    Args:
        heads: Titles of the columns.
        rows: Cells; each is converted by `str`.
        align: `l` or `r` for the columns after the first, which is aligned to the left; the last
            letter holds for all further columns.
    """
    letters = "l" + align + align[-1] * len(heads)
    rule = ["---:" if letter == "r" else "---" for letter in letters[: len(heads)]]
    lines = [[str(cell).replace("|", "\\|") for cell in row] for row in (heads, *rows)]
    head, *body = [f"| {' | '.join(cells)} |" for cells in lines]
    return [head, f"|{'|'.join(rule)}|", *body]
