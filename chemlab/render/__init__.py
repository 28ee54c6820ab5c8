"""Pictures of laboratories and benches: scenes as plain data, and functions that draw them.

``scene`` needs only NumPy. ``draw`` and ``frames`` need Pillow (extra ``plot``), and a window needs pygame (extra
``human``). Both packages are imported on first use.
"""
