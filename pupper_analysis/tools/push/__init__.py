"""Push robots over: how hard, which way?"""
