from . import figures as figures
from .page.job_page import prepared as prepared
from .page.job_page import write_page as write_page
