from .page import render as render
from .page import render_page as render_page
from .page import write_page as write_page
from .page import write_report as write_report
