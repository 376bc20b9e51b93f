"""A page as a browser would read it: its elements, and everything that it would load."""

import re
from html.parser import HTMLParser


class Page(HTMLParser):
    """Elements, texts of scripts, headings and rows of a page."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.scripts, self.headings, self.rows, self.text = [], [], [], [], ""
        self.open = None
        self.feed(page.decode())

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        self.open = tag
        if tag == "script":
            self.scripts.append((attributes, ""))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
        if tag in ("h1", "h2") or attributes.get("id") == "verdict":
            self.headings.append(attributes.get("id", tag))

    def handle_endtag(self, tag):
        self.open = None if tag in ("script", "style", "td", "th", "tr") else self.open

    def handle_data(self, data):
        if self.open == "script":
            attributes, before = self.scripts[-1]
            self.scripts[-1] = (attributes, before + data)
        elif self.open != "style":
            self.text += data
            if self.open in ("td", "th"):
                self.rows[-1][-1] += data

    def data(self, identifier):
        """Return the text of the data script with this name."""
        (text,) = [text for found, text in self.scripts if found.get("id") == identifier]
        return text

    def programs(self):
        """Return the scripts that are executed."""
        return [text for found, text in self.scripts if "type" not in found]


def loaded_from_elsewhere(page):
    """Return everything that elements and styles of a page would load."""
    parsed = Page(page)
    named = [
        value
        for _, attributes in parsed.tags
        for name, value in attributes.items()
        if name in ("src", "href", "srcset", "data", "action") and not value.startswith("#")
    ]
    styles = re.findall(r"<style>(.*?)</style>", page.decode(), re.DOTALL)
    return named + re.findall(r"url\(|@import", "".join(styles))
