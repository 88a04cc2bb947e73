from . import figures as figures
from . import tables as tables
from .document import page as page
from .document import prepared as prepared
from .document import write_page as write_page
from .pdf_document import pdf as pdf
from .pdf_document import write_pdf as write_pdf
