"""Pictures of laboratories and benches: what is to be drawn as data, and the drawing of it.

``scene`` needs nothing but numpy; ``draw`` and ``frames`` need Pillow (extra ``plot``), a window pygame (extra
``human``). Both are imported where they are used.
"""
