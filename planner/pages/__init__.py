"""Pages: what a browser shows of hands, plans and runs, one HTML file each, without a network.

``scene`` says what there is to see, as plain data; ``blocks`` what there is to read; ``page``
writes both into one file; ``plan_page`` and ``motion_page`` are the pages of what is planned.
"""
