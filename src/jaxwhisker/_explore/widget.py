"""The widget: the sliders in Jupyter."""

from typing import Any

from jaxwhisker._explore.assets import SCRIPT, STYLE
from jaxwhisker._explore.session import Session

try:
    import anywidget
    import traitlets
except ImportError as error:
    raise ImportError("`explore` needs anywidget in Jupyter: pip install jaxwhisker[explore]") from error


class Explorer(anywidget.AnyWidget):
    """The sliders of a session. A kernel answers one message after the other."""

    _esm = SCRIPT
    _css = STYLE
    description = traitlets.Dict().tag(sync=True)

    def __init__(self, session: Session):
        super().__init__(description=session.description)
        self._session = session
        self.on_msg(self._answer)

    def _answer(self, widget: Any, message: Any, buffers: Any) -> None:
        del widget, buffers
        try:
            reply = self._session.answer(message["values"])
        except ValueError as error:
            self.send({"id": message["id"], "error": str(error)})
        except KeyboardInterrupt:
            self.send({"id": message["id"], "error": "The kernel was interrupted: move a slider to go on."})
        else:
            self.send({"id": message["id"]}, buffers=[reply])
