"""The local app: a page on a project folder whose every action is a command of loopcal."""
