"""The app behind ``platform-ctrl serve``: a page in the browser on which the loops of a job are shaped by hand.

`backend.Backend` is all that pages need of a job: settings in; pictures, tuned settings, saved jobs and runs out.
`page` has the page's session and its messages, `plots` and `gimbal_tree` draw, `server` and `web` respond over HTTP.
"""
