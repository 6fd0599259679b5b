function build_model(name, runner, runner_port, own_port, channels, interval_s)
% Build a Simulink model of a target of the plain link (docs/reference/plain_link.md), with clock: target.
%
%   build_model('plain_target', '192.168.7.1', 47811, 47810, 3, 0.001)
%
% runner and runner_port: link.interface and link.own_port of the rig file; own_port: its link.port; channels: how many;
% interval_s: 1 / sample_rate_hz. The model has an input for the samples (V) and an output for the command (V): connect
% your converters there. Needs DSP System Toolbox (UDP Receive, UDP Send) and Embedded Coder (Byte Pack, Byte Unpack); with
% Simulink Real-Time change the library paths below to those of its own blocks. settings.txt has the same as text, for a
% model that is built by hand. Written from the documentation of these blocks and not tried in MATLAB by its authors:
% where a block has a parameter of another name, the script stops and lists the names that it has.
RECEIVE = 'dspsrcs4/UDP Receive';
SEND = 'dspsnks4/UDP Send';
PACK = 'embeddedtargetslib/Host Communication/Byte Pack';
UNPACK = 'embeddedtargetslib/Host Communication/Byte Unpack';
TICKS = 4;
tick = num2str(interval_s / TICKS, 17);
interval = num2str(interval_s, 17);

new_system(name);
set_param(name, 'SolverType', 'Fixed-step', 'Solver', 'FixedStepDiscrete', 'FixedStep', tick, 'StopTime', 'inf');

add_block(RECEIVE, [name '/From runner']);
by_prompt([name '/From runner'], 'Local IP port', num2str(own_port));
by_prompt([name '/From runner'], 'Remote IP address', ['''' runner '''']);
by_prompt([name '/From runner'], 'Maximum length for Message', '40');
by_prompt([name '/From runner'], 'Data type for Message', 'uint8');
by_prompt([name '/From runner'], 'Output variable-size signal', 'off');
by_prompt([name '/From runner'], 'Sample time', tick);

add_block(UNPACK, [name '/Unpack'], 'DataTypes', '{''uint32'',''double''}', 'Dimensions', '{6,2}', 'Alignment', '1');

add_block('simulink/Sources/In1', [name '/samples_v'], 'PortDimensions', num2str(channels), 'SampleTime', tick);
add_block('simulink/User-Defined Functions/MATLAB Function', [name '/Target']);
chart = find(sfroot, '-isa', 'Stateflow.EMChart', 'Path', [name '/Target']);
body = strrep(fileread('plain_target_block.m'), 'INTERVAL_S = 0.001', ['INTERVAL_S = ' interval]);
chart.Script = body;
add_block('simulink/Sinks/Out1', [name '/command_v']);

parts = {'head', 'reals', 'samples'};
for i = 1:3
    add_block('simulink/Discrete/Zero-Order Hold', [name '/' parts{i}], 'SampleTime', interval);
    add_line(name, ['Target/' num2str(i + 1)], [parts{i} '/1']);
end
add_block(PACK, [name '/Pack'], 'DataTypes', '{''uint32'',''double'',''double''}', 'Alignment', '1');
add_block(SEND, [name '/To runner']);
by_prompt([name '/To runner'], 'Remote IP address', ['''' runner '''']);
by_prompt([name '/To runner'], 'Remote IP port', num2str(runner_port));
by_prompt([name '/To runner'], 'Local IP port source', 'Specify via dialog');
by_prompt([name '/To runner'], 'Local IP port', num2str(own_port));

add_line(name, 'From runner/1', 'Unpack/1');
add_line(name, 'From runner/2', 'Target/1');
add_line(name, 'Unpack/1', 'Target/2');
add_line(name, 'Unpack/2', 'Target/3');
add_line(name, 'samples_v/1', 'Target/4');
add_line(name, 'Target/1', 'command_v/1');
for i = 1:3
    add_line(name, [parts{i} '/1'], ['Pack/' num2str(i)]);
end
add_line(name, 'Pack/1', 'To runner/1');
save_system(name);
end

function by_prompt(block, prompt, value)
% Set the parameter of a block whose prompt in the dialog begins with these words.
about = get_param(block, 'DialogParameters');
names = fieldnames(about);
prompts = cellfun(@(one) about.(one).Prompt, names, 'UniformOutput', false);
found = find(strncmpi(prompts, prompt, numel(prompt)) & ~strncmpi(prompts, [prompt ' source'], numel(prompt) + 7));
if endsWith(prompt, 'source')
    found = find(strncmpi(prompts, prompt, numel(prompt)));
end
if numel(found) ~= 1
    error('plain_link:block', '%s has no parameter "%s"; it has: %s', block, prompt, strjoin(prompts', '; '));
end
set_param(block, names{found}, value);
end
