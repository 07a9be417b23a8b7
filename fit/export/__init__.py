"""The weather of an hour in other engines' terms: what each keeps, what it approximates and by how much, what it drops.

Every target is a function of a `Described` weather that gives the texts and pictures of a folder and an `Account`.
"""
