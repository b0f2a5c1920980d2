"""The operator's panel: what the page shows and may ask for, who may ask, and the server that carries both.

The panel holds no authority: whatever it can do is a service or an action of another node.
"""
