"""Whether a picture can be read."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text


def legible(figure, monkeypatch):
    """The words of a picture, none of which is cut off or covers another."""
    drawn, draw = {}, Text.draw

    def note(text, renderer, *args, **named):
        if text.get_visible() and text.get_text().strip():
            drawn[id(text)] = text.get_text(), text.get_window_extent(renderer)
        return draw(text, renderer, *args, **named)

    monkeypatch.setattr(Text, "draw", note)
    FigureCanvasAgg(figure).draw()
    monkeypatch.undo()
    page, shown = figure.bbox, list(drawn.values())
    for i, (words, box) in enumerate(shown):
        inside = page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
        assert inside, f"{words!r} is cut"
        for others, other in shown[:i]:
            across = min(box.x1, other.x1) - max(box.x0, other.x0)
            up = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert across < 1 or up < 1, f"{words!r} and {others!r} overlap"
    return [words for words, _ in shown]
