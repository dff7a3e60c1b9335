"""Pictures as a page carries them: in its own text, as WebP, which is a tenth of the size of PNG."""

import base64
import io

from meshfit.report.drawing import Image
from meshfit.report.extra import needed

_QUALITY = 86


def data_uri(image: Image) -> str:
    """A picture as the source of an `<img>`."""
    content = io.BytesIO()
    needed("PIL.Image").fromarray(image).save(content, "WEBP", quality=_QUALITY, method=4)
    return f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"
