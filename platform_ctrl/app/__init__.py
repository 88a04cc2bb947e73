"""The app behind ``platform-ctrl serve``: a page in the browser on which the loops of a job are shaped by hand.

`backend.Backend` is all that pages need of a job: settings in; pictures, tuned settings, saved jobs and runs out.
`session` has a page's document and its requests, `fragments` writes its HTML, `plots` draws, `server` serves it.
"""
