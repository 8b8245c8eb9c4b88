"""Addresses of the documentation's pages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, metadata


def page_address(page: str) -> str:
    """Address of a page, as ``how-to/install``.

    On the site that the package's metadata name (``Documentation`` under ``[project.urls]`` of pyproject.toml), else
    in the source.
    """
    try:
        urls = metadata("monoloc").get_all("Project-URL") or []
    except PackageNotFoundError:
        urls = []
    sites = dict(url.split(", ", 1) for url in urls)
    site = sites.get("Documentation")
    return f"docs/{page}.md" if site is None else f"{site.rstrip('/')}/{page}/"
