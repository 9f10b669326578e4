"""What is seen: pictures, films and the window; pages of reports, and what ``view`` opens.

``targets`` recognises by its content what is to be viewed, ``browser`` brings it to one.
"""
