"""Checks of self-contained pages."""

from html.parser import HTMLParser


class Elements(HTMLParser):
    """Parser that collects tags with their attributes."""

    def __init__(self, page: str) -> None:
        """Parse a page."""
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Store a tag."""
        self.found.append((tag, dict(attrs)))


def check_that_no_request_leaves(page: str) -> None:
    """Check that no element makes a browser load anything."""
    for tag, attributes in Elements(page).found:
        assert tag not in ("script", "link", "iframe", "object", "base")
        for name in ("src", "href", "srcset", "poster", "action"):
            value = attributes.get(name) or "#"
            assert value.startswith(("#", "data:image/svg+xml;base64,")), (tag, value)
    assert "@import" not in page
    assert "url(" not in page
