"""What shows a view: a page from a server, notebooks, windows, terminals, and napari. Each carries a session's messages."""
