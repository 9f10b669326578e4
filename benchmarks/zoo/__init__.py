"""The hand zoo: what the planner makes of hands that others published, measured and as pages.

``models`` says which hands, ``objects`` what each is to grasp, ``measure`` plans and executes,
``pages`` writes the pages of the documentation from what was measured. Nobody's model is kept: only
facts that follow from it, and a small picture.
"""
