"""Browse every episode of a release or of a run in a page: served to this machine, or written into one file."""

from evaluator.view.opening import open_source
from evaluator.view.server import serving
from evaluator.view.static import WrittenPage, write_page
from evaluator.view.viewer import Viewer

__all__ = ["Viewer", "WrittenPage", "open_source", "serving", "write_page"]
