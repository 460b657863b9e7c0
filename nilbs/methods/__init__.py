"""Methods: each is one object whose fields are its settings; see `nilbs.methods.base.Method`.

A method is one file here, or one folder. Importing it loads no torch.
"""
