"""``tel check``: is an arm what its configuration says?"""
