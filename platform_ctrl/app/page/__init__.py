"""The page: what a browser shows of the designer, and what it may ask for. Bokeh is loaded with `page.app`."""
