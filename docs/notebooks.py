"""Notebooks as pages: each is executed in a new kernel, and becomes Markdown with the outputs it made there."""

import base64
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

_SECONDS_PER_CELL = 120


def executed(path: Path) -> Any:  # noqa: ANN401  a notebook of nbformat
    """Return a notebook with the outputs of its cells; a cell that fails stops the build.

    Args:
        path: of the notebook, which is not changed. It runs in an empty folder.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory(prefix="meshfit-") as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=_SECONDS_PER_CELL, kernel_name="python3", resources=resources).execute()
    return notebook


def as_markdown(notebook: Any, name: str) -> tuple[str, dict[str, bytes]]:  # noqa: ANN401  a notebook of nbformat
    """Return an executed notebook as Markdown, and the pictures that it refers to, by their names.

    Args:
        notebook: as `executed` returns it.
        name: of the notebook's file, which the page links to.
    """
    parts, pictures = [], dict[str, bytes]()
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            if len(parts) == 1:
                parts.append(f"[Download the notebook]({name})")
            continue
        parts.append(f"```python\n{cell.source}\n```")
        parts += [_output(output, Path(name).stem, pictures) for output in cell.outputs]
    return "\n\n".join(part for part in parts if part) + "\n", pictures


def _output(output: Any, stem: str, pictures: dict[str, bytes]) -> str:  # noqa: ANN401  an output of nbformat
    data = output.get("data", {"text/plain": output.get("text", "")})
    if "image/png" in data:
        picture = f"{stem}-{len(pictures)}.png"
        pictures[picture] = base64.b64decode(data["image/png"])
        return f"![output of the cell above]({picture})"
    if "text/html" in data:
        html = data["text/html"].replace('<table border="1" class="dataframe">', "<table>")  # styled as others
        return f'<div class="output">{"".join(html.splitlines())}</div>'
    return f"```text\n{data['text/plain'].strip()}\n```" if data["text/plain"].strip() else ""
