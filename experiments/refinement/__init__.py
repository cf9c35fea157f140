"""Do the answers depend on the number of nodes?"""
