"""Second readings of the files that the fuzzer changes, by other means than the package's.

Each is a function of the path of a file and the package's answer. It raises `AssertionError` where the answer is not
what the bytes of the file state.
"""
