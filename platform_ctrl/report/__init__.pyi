from . import figures as figures
from .page.job_page import write_page as write_page
