function t = plain_target_start()
% State of a target of the plain link that starts (docs/reference/plain_link.md). Whole numbers are doubles: exact here.
t.session = 0;      % of the newest session
t.state = 3;        % 1 RUNNING, 2 RESTING, 3 AT_REST
t.last = 0;         % newest number of the runner in this session
t.faults = 0;
t.acting = 0;       % number of the command that acts
t.acting_v = 0;     % that command, V
t.step_v = 0;       % by which the last commands moved in an interval, V
t.late = 0;         % instants since a command was put out
t.waiting = 0;      % number of a command that waits for its instant, 0: none
t.waiting_v = 0;
t.instant = 0;      % number of the next instant
t.output_v = 0;
t.fed_s = 0;        % when a command counted last
end
