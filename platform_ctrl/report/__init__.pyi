from . import figures as figures
from .page.job_page import page_html as page_html
from .page.job_page import prepared as prepared
from .page.job_page import write_page as write_page
from .pdf import pdf_bytes as pdf_bytes
from .pdf import write_pdf as write_pdf
