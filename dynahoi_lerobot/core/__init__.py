"""What every room uses: conventions, rules, features, episodes, agents, registries, and small
tools.
"""
