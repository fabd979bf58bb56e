"""Pages made of what lies outside `docs/`: the notebooks, CONTRIBUTING and CHANGELOG.

Of a notebook its text, its code, and whatever output is in it.

Notebooks are kept without output; `pytest --nbmake --overwrite notebooks`, run before the site is built, puts it in.
"""

from __future__ import annotations

import base64
import json
import pathlib
import re
from collections.abc import Sequence
from typing import Any

from mkdocs.structure.files import File, Files

PROJECT = pathlib.Path(__file__).resolve().parents[2]
NOTEBOOKS = PROJECT / "notebooks"
OWN = ("CONTRIBUTING.md", "CHANGELOG.md")
FIRST = ("quickstart", "first_fix")  # then the others, as a reader may want them
ORDER = (
    "terrain_searches",
    "searches_compared",
    "error_budget",
    "linear_vs_sampled",
    "which_hill",
    "tracking",
    "are_my_errors_true",
    "accuracy_map",
    "overlap_and_pointing",
    "when_to_expose",
    "strips_in_noise",
    "overlap_for_noise",
    "sweeping_camera",
    "rolling_shutter",
    "pose_from_fixes",
    "wrong_point",
    "bundle_adjustment",
    "blunders_and_weak_blocks",
    "images_without_a_map",
    "registration",
    "fixes_by_a_map",
    "wrong_map",
    "new_sensor",
    "new_search",
    "many_frames",
)
NOTEBOOK_LINK = re.compile(r"\]\(((?:\.\./)+)notebooks/(\w+)\.ipynb\)")  # as a page links to one in the checkout
LIST = "<!-- tutorials -->"
PICTURES = {"image/png": "png", "image/jpeg": "jpg"}


def on_config(config: Any, **_: Any) -> Any:
    """All notebooks under `Tutorials` of the navigation."""
    for entry in config.nav:
        if "Tutorials" in entry:
            entry["Tutorials"] += [f"tutorials/{path.stem}.md" for path in notebooks()]
    return config


def on_files(files: Files, *, config: Any, **_: Any) -> Files:
    """A page for each notebook, with its pictures beside it, and those of the project."""
    for name in OWN:
        text = (PROJECT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, name.lower(), content=text))
    for path in notebooks():
        text, pictures = page_of(path)
        files.append(File.generated(config, f"tutorials/{path.stem}.md", content=text))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"tutorials/{name}", content=picture))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links to notebooks as links to their pages; the list of tutorials, where a page asks for it."""
    markdown = NOTEBOOK_LINK.sub(lambda found: f"]({found[1][len('../') :]}tutorials/{found[2]}.md)", markdown)
    if LIST not in markdown:
        return markdown
    rows = []
    for path in notebooks():
        title, told = first_words(path)
        rows.append(f"### [{title}]({path.stem}.md)\n\n{told}")
    return markdown.replace(LIST, "\n\n".join(rows))


def notebooks() -> list[pathlib.Path]:
    """Those that there are, in the order in which they are read."""
    rank = {name: number for number, name in enumerate((*FIRST, *ORDER))}
    return sorted(NOTEBOOKS.glob("*.ipynb"), key=lambda path: (rank.get(path.stem, len(rank)), path.stem))


def first_words(path: pathlib.Path) -> tuple[str, str]:
    """Title and first paragraph of a notebook."""
    text = source(cells(path)[0])
    title, _, told = text.partition("\n")
    return title.lstrip("# ").strip(), told.strip().split("\n\n")[0]


def page_of(path: pathlib.Path) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by name."""
    parts, pictures = [], {}
    for number, cell in enumerate(cells(path)):
        text = source(cell)
        if cell["cell_type"] == "markdown":
            parts.append(from_here(text))
        elif cell["cell_type"] == "code" and text.strip():
            parts.append(f"```python\n{text}\n```")
        for place, output in enumerate(merged(cell.get("outputs", ()))):
            shown, more = output_of(output, f"{path.stem}-{number}-{place}")
            parts.append(shown)
            pictures |= more
    title, *rest = parts
    parts = [title, f"*The notebook: `notebooks/{path.name}`.*", *rest]
    return "\n\n".join(part for part in parts if part), pictures


def merged(outputs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What is printed in pieces, in one."""
    found: list[dict[str, Any]] = []
    for output in outputs:
        last = found[-1] if found else {}
        if output["output_type"] == "stream" and last.get("name") == output["name"]:
            last["text"] = joined(last["text"]) + joined(output["text"])
        else:
            found.append(dict(output))
    return found


def from_here(text: str) -> str:
    """Links of a notebook as they lead on from its page."""
    text = re.sub(r"\]\((?:\.\./notebooks/)?([\w-]+)\.ipynb\)", r"](\1.md)", text)
    text = re.sub(r"\]\(\.\./docs/([\w./-]+)\)", r"](../\1)", text)
    return re.sub(r"\]\(\.\./([A-Z]+\.md)\)", lambda found: f"](../{found[1].lower()})", text)


def output_of(output: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """An output of a cell as Markdown, and its picture by name."""
    data = output.get("data", {})
    for kind, ending in PICTURES.items():
        if kind in data:
            return f"![{name}]({name}.{ending})", {f"{name}.{ending}": base64.b64decode(joined(data[kind]))}
    if output["output_type"] == "stream" and output.get("name") == "stderr":
        return "", {}
    text = joined(output.get("text", data.get("text/plain", ""))).rstrip()
    return (f"```{{ .text .output }}\n{text}\n```" if text else ""), {}


def cells(path: pathlib.Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def source(cell: dict[str, Any]) -> str:
    return joined(cell["source"])


def joined(text: str | list[str]) -> str:
    return text if isinstance(text, str) else "".join(text)
