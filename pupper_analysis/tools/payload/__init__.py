"""How much can a stance carry, and what fails?"""
