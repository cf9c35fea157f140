"""The paper's validation, Fig. 4: do tasks of lower unattainability come closer to being accomplished?"""
