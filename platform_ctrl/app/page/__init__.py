"""The page: what a browser shows, and what it may request. Bokeh is loaded with `page.document`."""
