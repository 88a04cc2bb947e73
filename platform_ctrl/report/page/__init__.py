"""What the report of a job or a campaign says: blocks of text, tables and figures, and the HTML page made of them."""
