"""The content of the reports of jobs and campaigns, as blocks of text, tables and figures, and the HTML page."""
