"""`make docs`: the documentation as a site, from the pages as they lie in the repository.

Sphinx with MyST, which reads CommonMark as forges do, and Furo, which brings everything that its pages load. MkDocs
with Material was tried: it needs lists and blocks written in its own way, and its end is announced for May 2027.
"""
