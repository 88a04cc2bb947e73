"""The compiled kernel: the exact non-linear plant and its sampled loop, eight scenarios at a time, in bare numbers.

Nothing is allocated inside its loops, and every scenario's result is the same to the last bit whichever others stand
beside it.
"""
