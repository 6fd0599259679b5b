"""The designed step of a case as a C99 library: `rths export step`"""
