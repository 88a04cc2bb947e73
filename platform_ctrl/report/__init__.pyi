from . import figures as figures
from .job_page import write_page as write_page
