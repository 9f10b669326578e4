"""Pages: what a browser shows of hands, plans and runs, one HTML file each, without a network.

``scene`` says what there is to see, as plain data; ``page`` writes it into one file.
"""
