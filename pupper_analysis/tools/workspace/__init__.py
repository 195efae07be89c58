"""How far can the base go, with feet planted?"""
