"""Pages: one base template, one stylesheet and the scripts of all HTML that the commands write.

A page fetches nothing: its style and scripts are in it, or in files beside it, and a content security policy refuses
all others. Charts that zoom are drawn by uPlot (`uplot/`, its licence beside it).
"""
